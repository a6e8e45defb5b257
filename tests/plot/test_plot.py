import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib._pylab_helpers import Gcf
from matplotlib.image import imread

from manireg import plot


def spiral(t):
    latitude, longitude = 3 * t - 1.5, 9 * t
    x, y = np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude)
    return np.stack([x, y, np.sin(latitude)], axis=-1)


def test_globe_geometry():
    view = np.array([1.0, 2, 2]) / 3
    drawn = plot.globe(view=view)
    np.testing.assert_allclose(drawn.turn @ drawn.turn.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(drawn.turn) == pytest.approx(1)
    place, near = drawn.flatten(np.stack([view, -view, [0, 0, 1], [0, 1, 0]]))
    np.testing.assert_allclose(place[:2], 0, atol=1e-15)
    assert place[2, 0] == pytest.approx(0) and place[2, 1] > 0
    assert place[3, 0] > 0
    np.testing.assert_array_equal(near, [True, False, True, True])


@pytest.mark.parametrize("pole", [1, -1])
def test_globe_from_above(pole):
    turn = plot.globe(view=(0, 0, pole)).turn
    np.testing.assert_allclose(turn @ [0, 0, pole], [0, 0, 1], atol=1e-15)


def test_view_of_sees_the_points():
    rng = np.random.default_rng(0)
    for _ in range(5):
        centre = rng.normal(size=3)
        centre /= np.linalg.norm(centre)
        points = centre + 0.4 * rng.normal(size=(30, 3))
        points /= np.linalg.norm(points, axis=-1, keepdims=True)
        assert plot.view_of(points) @ centre > 0.8
    everywhere = rng.normal(size=(4000, 3))
    assert np.linalg.norm(plot.view_of(everywhere)) == pytest.approx(1)


def test_globe_path_is_split_at_the_rim():
    drawn: Any = plot.globe(view=(1, 0, 0), graticule=0)
    angle = np.linspace(0, 2 * np.pi, 50)
    equator = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    drawn.path(equator)
    front, back = drawn.axes.collections
    lengths = [
        np.linalg.norm(np.diff(np.array(c.get_segments()), axis=1), axis=-1).sum()
        for c in (front, back)
    ]
    assert lengths[0] == pytest.approx(2, abs=0.02)
    assert lengths[1] == pytest.approx(2 * 0.6, abs=0.1)


def test_globe_circles_have_their_radius():
    drawn: Any = plot.globe(view=(1, 0, 0), graticule=0)
    drawn.circles([[1, 0, 0], [-1, 0, 0]], [30.0, 10.0])
    front, back = (c.get_paths()[0].vertices for c in drawn.axes.collections)
    np.testing.assert_allclose(np.linalg.norm(front, axis=-1), 0.5)
    np.testing.assert_allclose(np.linalg.norm(back, axis=-1), np.sin(np.radians(10)))


@pytest.mark.parametrize("a95", [None, np.full(20, 5.0)])
def test_sphere_path(tmp_path, a95):
    x = np.linspace(0, 1, 20)
    picture: Any = plot.sphere_path(spiral, x, 2 * spiral(x), a95=a95, label="time")
    axes, bar = picture.axes
    assert bar.get_ylabel() == "time"
    shown = sum(len(c.get_offsets()) for c in axes.collections if c.get_zorder() == 6)
    pale = sum(len(c.get_offsets()) for c in axes.collections if c.get_zorder() == 1.5)
    assert shown + pale == 20 and shown >= 10
    plot.save(picture, tmp_path / "path.png")
    height, width, _ = imread(tmp_path / "path.png").shape
    assert 700 < height < 1000 and 900 < width < 1200
    plot.save(picture, tmp_path / "path.pdf")
    assert (tmp_path / "path.pdf").read_bytes().startswith(b"%PDF")


def test_sphere_path_enlarges_what_is_small():
    x = np.linspace(0, 1, 20)
    picture: Any = plot.sphere_path(
        lambda t: spiral(0.5 + t / 50), x, spiral(0.5 + x / 50)
    )
    axes = picture.axes[0]
    place = axes.collections[-2].get_offsets()
    assert np.abs(place).max() < axes.get_xlim()[1] < 1.5 * np.abs(place).max()


def test_sphere_path_draws_into_given_axes():
    picture: Any = plot.figure(7, 3)
    left, right = picture.subplots(1, 2)
    x = np.linspace(0, 1, 9)
    for axes in (left, right):
        assert plot.sphere_path(spiral, x, spiral(x), ax=axes) is picture


def test_cv_curve():
    lams = np.array([1.0, 0.01, 0.1])
    scores = np.array([[3.0, 1.0, 2.0], [5.0, 1.0, 4.0]])
    cv = SimpleNamespace(lam=0.01, lams=lams, scores=scores)
    picture: Any = plot.cv_curve(cv)
    (axes,) = picture.axes
    curve, _, bars = axes.containers[0]
    np.testing.assert_allclose(curve.get_xdata(), [0.01, 0.1, 1])
    np.testing.assert_allclose(curve.get_ydata(), [1, 3, 4])
    ends = np.array(bars[0].get_segments())[:, :, 1]
    np.testing.assert_allclose(ends, [[1, 1], [2, 4], [3, 5]])
    assert axes.get_xscale() == "log"
    assert axes.get_legend().get_texts()[0].get_text() == r"$\lambda = 0.01$"


def test_cv_curve_leaves_out_what_was_not_tried():
    lams = np.array([0.01, 0.1, 1.0, 10.0])
    scores = np.array([[1.0, 2.0, 31.0, np.inf], [1.0, 3.0, 33.0, np.inf]])
    cv = SimpleNamespace(lam=0.01, lams=lams, scores=scores)
    (axes,) = plot.cv_curve(cv).axes  # type: ignore[attr-defined]
    curve = axes.containers[0][0]
    np.testing.assert_allclose(curve.get_xdata(), [0.01, 0.1, 1])
    assert axes.get_yscale() == "log" and axes.get_ylim()[1] < 100


def test_coordinates_curves():
    x = np.linspace(0, 1, 9)
    y = np.stack([x, -x, x**2, 1 - x], axis=-1).reshape(9, 2, 2)
    picture: Any = plot.coordinates(
        lambda t: np.stack([t, -t, t**2, 1 - t], axis=-1).reshape(-1, 2, 2), x, y
    )
    assert len(picture.axes) == 4
    fitted, observed = picture.axes[2].lines
    np.testing.assert_allclose(fitted.get_ydata(), fitted.get_xdata() ** 2)
    np.testing.assert_allclose(observed.get_ydata(), x**2)
    assert picture.axes[2].get_ylabel() == "$y_{2,1}$"


def test_coordinates_maps():
    x = np.random.default_rng(0).uniform(size=(30, 2))
    y = np.stack([x[:, 0], x[:, 1], x.sum(1), x[:, 0] * x[:, 1]], axis=-1)
    names = ("a", "b", "c", "d")
    picture: Any = plot.coordinates(
        lambda u: np.stack([u[:, 0], u[:, 1], u.sum(1), u.prod(1)], axis=-1),
        x,
        y,
        names=names,
        label=("depth", "width"),
    )
    mesh, dots = picture.axes[2].collections
    grid = mesh.get_coordinates()
    np.testing.assert_allclose(mesh.get_array().reshape(60, 60), grid.sum(-1))
    np.testing.assert_allclose(dots.get_array(), x.sum(1))
    assert picture.axes[2].get_title() == "c"


def test_coordinates_of_three_inputs():
    with pytest.raises(ValueError, match=r"one or two inputs, `x` has shape \(5, 3\)"):
        plot.coordinates(spiral, np.zeros((5, 3)), np.zeros((5, 3)))


def test_pictures_show_themselves_and_leave_no_state():
    picture: Any = plot.globe().figure
    assert picture._repr_png_().startswith(b"\x89PNG")
    assert Gcf.get_all_fig_managers() == []


def test_without_matplotlib(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'manireg\[plots\]'"):
        plot.globe()
