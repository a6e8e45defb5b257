"""Plain periodic numbers as inputs: the same fit as on the circle, drawn by hand."""

import datetime

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import manireg as mr

PERIOD, LAM = 24.0, 5.0
DAY, SPHERE = mr.Circle(PERIOD), mr.Sphere(2)
HOURS = np.sort(np.random.default_rng(0).uniform(0, PERIOD, 24))
NEW = np.linspace(0, PERIOD, 9)


def curve(hours):
    """A closed curve on the sphere, not a circle."""
    angle = 2 * np.pi * np.asarray(hours) / PERIOD
    z = 0.4 * np.sin(2 * angle)
    rho = np.sqrt(1 - z**2)
    return np.stack([rho * np.cos(angle), rho * np.sin(angle), z], axis=-1)


def by_hand(hours):
    angle = 2 * np.pi * np.asarray(hours) / PERIOD
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return PERIOD / (2 * np.pi) * unit


Y = curve(HOURS)


@pytest.fixture(scope="module")
def model():
    return mr.fit(DAY, SPHERE, HOURS, Y, LAM)


def test_same_as_unit_vectors_by_hand(model):
    ring = mr.Sphere(1, PERIOD / (2 * np.pi))
    other = mr.fit(ring, SPHERE, by_hand(HOURS), Y, LAM)
    np.testing.assert_allclose(model(NEW), other(by_hand(NEW)), atol=1e-10)
    assert model.energies.eells == pytest.approx(float(other.energies.eells), rel=1e-8)


def test_branches_and_shapes_of_x(model):
    other = mr.fit(
        DAY, SPHERE, (HOURS + PERIOD * (-3 + np.arange(24) % 5))[:, None], Y, LAM
    )
    np.testing.assert_allclose(other(NEW - 5 * PERIOD), model(NEW), atol=1e-10)
    np.testing.assert_allclose(model(NEW[:, None]), model(NEW), atol=1e-13)
    assert model(3.0).shape == (3,)
    assert model([3.0]).shape == model([[3.0]]).shape == (1, 3)
    with pytest.raises(ValueError, match=r"x: expected shape \(k,\) for Circle"):
        model(np.zeros((2, 2)))


def test_the_curve_is_closed(model):
    slope = jax.jacfwd(model)
    np.testing.assert_allclose(model(PERIOD), model(0.0), atol=1e-12)
    np.testing.assert_allclose(slope(PERIOD), slope(0.0), atol=1e-12)
    assert jnp.linalg.norm(slope(0.0)) > 0.1


def test_transforms_of_the_model(model):
    x = jnp.asarray(NEW)
    np.testing.assert_allclose(jax.vmap(model)(x), model(NEW), atol=1e-13)
    np.testing.assert_allclose(jax.jit(model)(x[2]), model(NEW[2]), atol=1e-13)
    height = lambda x: model(x)[2]
    change = (height(5.0 + 1e-5) - height(5.0 - 1e-5)) / 2e-5
    assert jax.grad(height)(5.0) == pytest.approx(float(change), rel=1e-6)


def test_energy_of_the_model_as_a_map(model):
    energy = mr.eells_energy(DAY, SPHERE, model, samples=1000)
    assert energy == pytest.approx(float(model.energies.eells), rel=1e-2)


def test_great_circles_cost_nothing():
    """Of the period, whatever its unit."""
    for period in (1.0, 360.0):
        great = lambda x: jnp.array([jnp.cos(2 * jnp.pi * x / period),
                                     jnp.sin(2 * jnp.pi * x / period), 0.0])  # fmt: skip
        twice = lambda x: great(2 * x)
        circle = mr.Circle(period)
        assert mr.eells_energy(circle, SPHERE, twice, 100) < 1e-20
        plate = mr.thin_plate_energy(circle, twice, 100)
        expected = (4 * np.pi / period) ** 4 * period
        assert plate == pytest.approx(expected, rel=1e-10)


def test_nadaraya_watson_measures_along_the_arc():
    found = mr.baselines.nadaraya_watson(DAY, SPHERE, HOURS, Y, 1.5)
    apart = np.abs(NEW[:, None] - HOURS)
    apart = np.minimum(apart, PERIOD - apart)
    share = np.exp(-(apart**2) / (2 * 1.5**2))
    flat = mr.baselines.nadaraya_watson(DAY, mr.Euclidean(3), HOURS, Y, 1.5)
    np.testing.assert_allclose(
        flat(NEW), share @ Y / share.sum(axis=1, keepdims=True), atol=1e-8
    )
    np.testing.assert_allclose(found(NEW[-1]), found(NEW[0]), atol=1e-8)


@pytest.mark.parametrize("period", [0.0, -1.0, np.inf, np.nan])
def test_bad_periods(period):
    with pytest.raises(ValueError, match="Circle: `period` must be positive"):
        mr.Circle(period)


def test_what_a_circle_does_not_take():
    with pytest.raises(ValueError, match="period` is one number"):
        mr.Circle([1.0, 2.0])
    with pytest.raises(
        ValueError, match="Circle: `period`: .*found dates or durations"
    ):
        mr.Circle(datetime.timedelta(days=1))
    dates = np.datetime64("2024-01-01") + np.arange(24)
    with pytest.raises(ValueError, match="x: .*found dates or durations"):
        mr.fit(DAY, SPHERE, dates, Y, LAM)
    with pytest.raises(ValueError, match="geodesic_regression is defined for Interval"):
        mr.baselines.geodesic_regression(DAY, SPHERE, HOURS, Y)


def test_gait_cycles_are_closed_curves_of_rotations(data_folder):
    """Of a noisy cycle, half of the noise is smoothed away, and the curve is closed."""
    table = np.load(data_folder / "tables" / "so3_gait_vespa64.npz")
    cycle = table["quaternion_wxyz"][0].astype(float)
    true = Rotation.from_quat(cycle, scalar_first=True)
    percent = table["time"]
    turns = np.radians(3) * np.random.default_rng(0).normal(size=(34, 3))
    seen = true[::3] * Rotation.from_rotvec(turns)
    gait = mr.fit(mr.Circle(100), mr.SpecialOrthogonal(3), percent[::3], seen, 10.0)
    found = Rotation.from_matrix(np.asarray(gait(percent)))
    error = lambda a, b: np.degrees(np.mean((a.inv() * b).magnitude()))
    assert error(found, true) < 0.5 * error(seen, true[::3])
    np.testing.assert_allclose(gait(100.0), gait(0.0), atol=1e-12)
