import sys
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest
import trimesh
from matplotlib import colormaps
from matplotlib._pylab_helpers import Gcf
from matplotlib.image import imread
from scipy.stats import chi2

import manireg as mr
from manireg import plot
from manireg.plot._band import envelope, spread_along


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


def circle_about(centre, radius, m=73):
    """A small circle, its first point again last."""
    e1, e2 = np.linalg.svd(np.asarray(centre, float)[None])[2][1:]
    angle = np.linspace(0, 2 * np.pi, m)[:, None]
    ring = np.cos(angle) * e1 + np.sin(angle) * e2
    return np.cos(radius) * np.asarray(centre) + np.sin(radius) * ring


def inside(band, places):
    """Of each place, whether one of the pieces holds it."""
    pieces = [path.contains_points(np.asarray(places)) for path in band.get_paths()]
    return np.any(pieces, axis=0)


def bands_of(drawn, *band):
    """What is drawn, on the near and the far side."""
    before = len(drawn.axes.collections)
    drawn.band(*band)
    return drawn.axes.collections[before:]


def test_globe_band_is_the_union_of_its_regions():
    drawn: Any = plot.globe(view=(1, 0, 0), graticule=0)
    angle = np.linspace(-1.0, 1.0, 9)
    centres = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    band, far = bands_of(drawn, np.stack([circle_about(c, 0.2) for c in centres]))
    assert not far.get_paths()
    for height, width in ((0.0, 0.9), (0.15, 0.8), (-0.15, 0.0)):
        assert inside(band, [[width, height]])
    # the hull of two regions reaches about as far as these, and no farther
    assert not inside(band, [[0.0, 0.21]]) and not inside(band, [[0.98, 0.0]])
    between = 0.5 * (angle[3] + angle[4])
    assert inside(band, [[np.sin(between), np.sin(0.19)]])


def test_globe_band_ends_at_the_rim():
    drawn: Any = plot.globe(view=(1, 0, 0), graticule=0)
    angle = np.linspace(0.0, np.pi, 30)
    centres = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    near, far = bands_of(drawn, np.stack([circle_about(c, 0.1) for c in centres]))
    assert np.all(near.get_facecolor()[0] <= far.get_facecolor()[0])
    assert near.zorder > far.zorder
    for band in (near, far):
        lengths = [np.linalg.norm(p.vertices, axis=1) for p in band.get_paths()]
        lengths = np.concatenate(lengths)
        assert lengths.max() == pytest.approx(1.0, abs=1e-12)
        assert inside(band, [[0.995, 0.0], [0.5, 0.05]]).all()
        assert not inside(band, [[-0.2, 0.0], [0.9, 0.2]]).any()


@pytest.mark.parametrize("radius", [0.3, 1.2, 1e-9])
def test_envelopes_are_on_the_near_side(radius):
    """Area of what a cap shows, whose middle lies on the rim: half of the ellipse that
    its circle is on the paper, and the rest up to the rim."""
    rims = np.stack([circle_about([1.0, 0, 0], radius, 721)] * 2)
    (piece,) = envelope(rims) if radius > 1e-6 else [np.zeros((3, 2))]
    x, y = piece.T
    area = 0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])
    expected = radius - np.sin(radius) * np.cos(radius)
    assert area == pytest.approx(expected, rel=3e-3, abs=1e-15)


def test_band_follows_inputs_and_path():
    inputs = np.linspace(2.0, 4.0, 501)
    turn = np.where(inputs < 3, 0.0, inputs - 3)  # it stands, then goes
    path = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    at = spread_along(inputs, path, 91)
    assert at[0] == 2 and at[-1] == 4
    steps = np.diff(at)
    assert steps[0] == pytest.approx(3 * steps[-1], rel=0.02)


@pytest.fixture(scope="module")
def pole_path():
    rng = np.random.default_rng(0)
    x = np.linspace(0, 1, 25)
    y = spiral(0.3 + 0.4 * x) + 0.05 * rng.normal(size=(25, 3))
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return x, y, mr.fit(mr.Interval(0, 1), mr.Sphere(2), x, y, 1e-4)


def test_sphere_path_with_its_band(pole_path):
    x, y, model = pole_path
    weights = np.linspace(0, 0.5, 25)
    picture: Any = plot.sphere_path(model, x, y, level=0.9, weights=weights)
    bare: Any = plot.sphere_path(model, x, y)
    axes = picture.axes[0]
    dots = [c for c in axes.collections if c.get_zorder() in (1.5, 6)]
    sizes = np.sort(np.concatenate([c.get_sizes() for c in dots]))
    assert sizes[0] == 1.5 and sizes[-1] == 9 and np.all(np.diff(sizes) >= 0)
    assert sizes[-2] == pytest.approx(9 * weights[-2] / 0.5)
    wider: Any = plot.sphere_path(model, x, y, level=0.999)
    areas = [_band_area(drawn.axes[0]) for drawn in (bare, picture, wider)]
    assert areas[0] == 0 and areas[2] > 1.2 * areas[1] > 0
    with pytest.raises(ValueError, match=r"weights: expected shape \(25,\)"):
        plot.sphere_path(model, x, y, weights=weights[1:])


def _band_area(axes):
    at = np.stack(np.meshgrid(*[np.linspace(-1, 1, 200)] * 2), axis=-1).reshape(-1, 2)
    bands = [c for c in axes.collections if c.get_zorder() == 2.5]
    return sum(np.mean(inside(band, at)) for band in bands)


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


def test_cv_curve_of_several_orders():
    """Over wavelength, the one chosen marked."""
    lams, scores = np.array([0.01, 0.1, 1.0]), np.array([[3.0, 1.0, 2.0]] * 2)
    path = SimpleNamespace(lams=lams, scores=scores, wavelengths=lams ** (1 / 4))
    cv = SimpleNamespace(
        **vars(path), lam=0.1, chosen=1, order=3, paths={2: path, 3: path}
    )
    (axes,) = plot.cv_curve(cv).axes  # type: ignore[attr-defined]
    for container in axes.containers:
        np.testing.assert_allclose(container[0].get_xdata(), path.wavelengths)
    legend: Any = axes.get_legend()
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels == [r"order 3, $\lambda = 0.1$", "order 2", "order 3"]
    assert axes.get_xlabel() == "wavelength"


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


@pytest.mark.parametrize("target", [mr.Euclidean(3), mr.Sphere(2)], ids=["R3", "S2"])
def test_coordinates_with_bands(pole_path, target):
    """Of each coordinate, nine tenths of random maps are below the upper end."""
    x, y, model = pole_path
    if target.dim == 3:
        model = mr.fit(mr.Interval(0, 1), target, x, y, 1e-4)
    picture: Any = plot.coordinates(model, x, y, level=0.8)
    at = np.linspace(0, 1, 200)[20::20]  # at the end random maps leave N
    drawn = model.posterior().sample(jax.random.key(0), 300)
    values = np.array([np.asarray(one(at)) for one in drawn])
    spread = np.ptp(np.quantile(values, [0.1, 0.9], axis=0), axis=0) / 2
    curves = np.asarray(model(at)).T
    for panel, expected, middle in zip(picture.axes, spread.T, curves, strict=True):
        (band,) = panel.collections
        corners = band.get_paths()[0].vertices
        for t, r, m in zip(at, expected, middle, strict=True):
            heights = corners[np.abs(corners[:, 0] - t) < 1e-9, 1]
            middle_of = (heights.min() + heights.max()) / 2
            assert middle_of == pytest.approx(m, abs=1e-6)
            assert np.ptp(heights) / 2 == pytest.approx(r, rel=0.3)


def test_bands_are_of_one_input():
    x = np.random.default_rng(0).uniform(size=(9, 2))
    with pytest.raises(ValueError, match=r"level: .*one input.*shape \(9, 2\)"):
        plot.coordinates(lambda u: u, x, x, level=0.9)
    with pytest.raises(ValueError, match="level: .*between 0 and 1; found 95"):
        plot.coordinates(lambda u: u, x[:, 0], x, level=95)


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


def test_residuals(pole_path):
    x, y, model = pole_path
    found = model.summary()
    picture: Any = plot.residuals(model)
    along, quantiles, pull = picture.axes
    dots = along.lines[0]
    np.testing.assert_allclose(dots.get_xdata(), x)
    np.testing.assert_allclose(dots.get_ydata(), found.each.left_out / found.sigma)
    dots, _, diagonal = quantiles.lines
    share = chi2.cdf(dots.get_xdata(), 2)
    np.testing.assert_allclose(np.sort(share), (np.arange(25) + 0.5) / 25)
    squares = dots.get_ydata()
    np.testing.assert_allclose(squares, found.each.standardised**2)
    assert np.all(np.diff(squares[np.argsort(share)]) >= 0)
    np.testing.assert_array_equal(diagonal.get_xdata(), diagonal.get_ydata())
    np.testing.assert_allclose(pull.lines[0].get_ydata(), found.each.leverages)
    worst = sorted(map(str, found.worst.data))
    for panel in picture.axes:
        assert sorted(text.get_text() for text in panel.texts) == worst
    assert along.get_xlabel() == "input" and quantiles.get_xscale() == "linear"
    assert picture._repr_png_().startswith(b"\x89PNG")


def test_residuals_of_two_inputs_with_an_outlier():
    x = np.random.default_rng(0).uniform(size=(30, 2))
    y = np.sum(x, axis=1, keepdims=True) + 0.01 * np.sin(50 * x[:, :1])
    y[4] += 9.0
    box = mr.Box([0, 0], [1, 1])
    options = {"loss": mr.Huber(), "sigma": 0.01, "scatter": "none", "centres": 20}
    model = mr.fit(box, mr.Euclidean(1), x, y, 1e-2, **options)
    along, quantiles, _ = plot.residuals(model).axes
    np.testing.assert_array_equal(along.lines[0].get_xdata(), np.arange(30))
    assert along.get_xlabel() == "index" and quantiles.get_xscale() == "log"


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


def painted(picture: Any):
    """Triangles of a surface in the order of drawing, and their colours."""
    (drawn,) = picture.axes[0].collections
    return [path.vertices[:3] for path in drawn.get_paths()], drawn.get_facecolors()


def two_squares():
    """A small one before a large one, seen along z; triangles of the back face away."""
    square = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    near = np.append(0.5 * square, np.full((4, 1), 2.0), axis=1)
    far = np.append(square, np.zeros((4, 1)), axis=1)
    front = np.array([[0, 1, 2], [0, 2, 3]])
    faces = np.concatenate([front, front + 4, front[:, ::-1] + 4])
    return trimesh.Trimesh(np.concatenate([near, far]), faces, process=False)


def test_surface_draws_what_faces_the_viewer_far_ones_first(tmp_path):
    picture: Any = plot.figure(3, 3)
    mesh, values = two_squares(), np.array([0.0, 5.0, 0.5, 1.0, 9.0, 9.0])
    plot.surface(picture.add_subplot(), mesh, values, (0.0, 5.0), view=(0, 0, 1))
    triangles, colours = painted(picture)
    corners = mesh.vertices[mesh.faces][:, :, :2]
    apart = np.abs(np.asarray(triangles)[:, None] - corners[:4]).max(axis=(2, 3))
    order, gap = apart.argmin(axis=1), apart.min(axis=1)
    assert np.all(gap < 1e-12)
    assert {*order[:2]} == {2, 3} and {*order[2:]} == {0, 1}
    light = 0.25 + 0.75 * np.clip(0.35 + 0.65 * 0.866, 0, 1)
    table = colormaps["viridis"](values[:4] / 5.0)[:, :3]
    np.testing.assert_allclose(colours[:, :3], light * table[order], atol=1e-12)
    plot.save(picture, tmp_path / "squares.png")
    image = imread(tmp_path / "squares.png")[:, :, :3]
    high, wide = image.shape[0] // 2, image.shape[1] // 2
    step = (
        min(high, wide) // 10
    )  # inside the small square, to either side of its diagonal
    below, above = image[high + step, wide + step], image[high - step, wide - step]
    np.testing.assert_allclose(below, light * table[0], atol=0.02)
    np.testing.assert_allclose(above, light * table[1], atol=0.02)


def test_surface_takes_values_of_vertices_and_any_view():
    ball = trimesh.creation.icosphere(2)
    height = np.asarray(ball.vertices)[:, 2]
    flat, turned = plot.figure(3, 3), plot.figure(3, 3)
    view = np.array([1.0, -2.0, 0.5])
    plot.surface(
        flat.add_subplot(), ball, height, (-1.0, 1.0), view=tuple(view), up=(0, 0, 1)
    )
    triangles, colours = painted(flat)
    shown = ball.face_normals @ view > 0
    assert len(triangles) == np.sum(shown)
    # up is up: the colour of the height, darker or lighter
    place = np.array([t[:, 1].mean() for t in triangles])
    assert np.corrcoef(place, colours[:, 1])[0, 1] > 0.8
    by_face = height[ball.faces].mean(axis=1)
    plot.surface(
        turned.add_subplot(), ball, by_face, (-1.0, 1.0), view=tuple(view), up=(0, 0, 1)
    )
    np.testing.assert_array_equal(painted(turned)[1], colours)


def test_registration_shows_how_much_areas_stretch():
    ball = trimesh.creation.icosphere(1)
    bigger = 1.5 * np.asarray(ball.vertices)
    bent = np.where(bigger[:, :1] > 0, bigger, ball.vertices)

    def mesh(t=1.0):
        return trimesh.Trimesh((1 - t) * ball.vertices + t * bent, ball.faces)

    stretch = mesh().area_faces / ball.area_faces
    found = SimpleNamespace(mesh=mesh, stretch=lambda: stretch)
    picture: Any = plot.registration(found, morph=0.25)
    *panels, bar = picture.axes
    titles = [ax.get_title() for ax in panels]
    assert titles == ["source", "morph 25 %", "registered"]
    extent = [np.diff(ax.get_xlim())[0] for ax in panels]
    assert extent[0] < extent[1] < extent[2]
    limit = 2 ** np.percentile(np.abs(np.log2(stretch)), 98)
    np.testing.assert_allclose(bar.get_ylim(), [1 / limit, limit])
    plain = panels[0].collections[0].get_facecolors()[:, :3]
    coloured = panels[2].collections[0].get_facecolors()[:, :3]
    shade = lambda rgb: np.ptp(rgb, axis=1) / rgb.max(axis=1)
    assert np.ptp(shade(plain)) < 0.01 < np.ptp(shade(coloured))
