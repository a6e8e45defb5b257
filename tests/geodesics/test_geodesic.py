"""Shortest curves, against closed forms, exponential maps and symmetry."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from clouds import sphere_cloud, torus_cloud

import manireg as mr
from manireg._discretisation.domain import discretise


def chord_lengths(points):
    return np.linalg.norm(np.diff(points, axis=-2), axis=-1)


def test_great_circles():
    sphere = mr.Sphere(2, 3.0)
    p, q = sphere.random_points(jax.random.key(0), 12).reshape(2, 6, 3)
    found = mr.geodesic(sphere, p, q)
    assert np.all(found.converged)
    angle = np.arccos(np.sum(p * q, axis=1) / 9)
    np.testing.assert_allclose(found.length, 3 * angle, rtol=1e-7)
    np.testing.assert_allclose(found.velocity, sphere.log(p, q), atol=1e-5)
    times = np.linspace(0, 1, 65)[:, None]
    sine = np.sin(angle)[:, None, None]
    weights = [np.sin(t * angle[:, None, None]) / sine for t in (1 - times, times)]
    exact = weights[0] * p[:, None] + weights[1] * q[:, None]
    np.testing.assert_allclose(found.points, exact, atol=1e-10)


@pytest.mark.slow
def test_length_is_of_fourth_order():
    ellipsoid = mr.Ellipsoid((1.0, 1.5, 2.0))
    p = jnp.array([1.0, 0.0, 0.0])
    v = jnp.array([0.0, 1.2, 0.9])
    q = ellipsoid.exp(p, v)
    coarse, fine = (
        abs(float(mr.geodesic(ellipsoid, p, q, segments=n).length) - 1.5)
        for n in (8, 16)
    )
    assert fine < 1e-4
    assert fine < coarse / 10


def shots(manifold, n, length):
    """Points, and a tangent vector of the given length at each."""
    p = manifold.random_points(jax.random.key(0), n)
    v = manifold.tangent_projection(p, jax.random.normal(jax.random.key(1), p.shape))
    return p, length * v / jnp.linalg.norm(v, axis=1, keepdims=True)


@pytest.mark.slow
def test_torus_against_its_exponential_map():
    torus = mr.Torus(2.0, 0.8)
    p, v = shots(torus, 5, 1.2)
    found = mr.geodesic(torus, p, torus.exp(p, v))
    assert np.all(found.converged)
    np.testing.assert_allclose(found.length, 1.2, rtol=1e-6)
    np.testing.assert_allclose(found.velocity, v, atol=2e-3)
    half = torus.exp(p, v / 2)
    np.testing.assert_allclose(found.points[:, 32], half, atol=2e-4)
    steps = chord_lengths(found.points)
    np.testing.assert_allclose(steps, steps[:, :1] * np.ones(64), rtol=1e-3)


def test_around_the_hole():
    """The chord of opposite points of the inner equator meets the axis, and their
    midpoint has no closest point."""
    torus = mr.Torus(2.0, 0.8)
    found = mr.geodesic(torus, jnp.array([1.2, 0, 0]), jnp.array([-1.2, 0, 0]))
    assert found.converged
    assert float(found.length) == pytest.approx(1.2 * np.pi, rel=1e-6)


def test_helix():
    """A cylinder unrolls to a strip."""
    p, q = jnp.array([[1.5, 0.0, 0.0], [0.0, 1.5, 2.0]])
    found = mr.geodesic(mr.Cylinder(1.5), p, q)
    exact = np.hypot(1.5 * np.pi / 2, 2.0)
    assert float(found.length) == pytest.approx(exact, rel=1e-7)
    np.testing.assert_allclose(found.points[:, 2], np.linspace(0, 2, 65), atol=1e-10)


@pytest.mark.slow
def test_rotations():
    group = mr.SpecialOrthogonal(3)
    p, q = group.random_points(jax.random.key(0), 4).reshape(2, 2, 3, 3)
    found = mr.geodesic(group, p, q, segments=16)
    exact = jnp.sqrt(group.squared_distance(p, q))
    np.testing.assert_allclose(found.length, exact, rtol=1e-5)
    assert found.points.shape == (2, 17, 3, 3)


@pytest.mark.slow
def test_vmap_and_broadcasting():
    sphere = mr.Sphere(2)
    p, q = sphere.random_points(jax.random.key(0), 6).reshape(2, 3, 3)
    table = mr.geodesic(sphere, p[:, None], q)
    assert table.points.shape == (3, 3, 65, 3)
    one = lambda p, q: mr.geodesic(sphere, p, q).length
    rows = jax.vmap(jax.vmap(one, (None, 0)), (0, None))(p, q)
    np.testing.assert_allclose(rows, table.length, rtol=1e-12)


@pytest.mark.slow
def test_of_no_length():
    p = jnp.array([0.0, 0.0, 1.0])
    for space in (mr.Sphere(2), sphere_cloud(320)):
        found = mr.geodesic(space, p, p)
        assert found.converged
        assert float(found.length) < 1e-12
        np.testing.assert_allclose(found.velocity, 0.0, atol=1e-12)


def test_cloud_of_a_sphere():
    sphere = mr.Sphere(2)
    p, q = sphere.random_points(jax.random.key(0), 16).reshape(2, 8, 3)
    found = mr.geodesic(sphere_cloud(2000), p, q)
    assert np.all(found.converged)
    np.testing.assert_allclose(found.length, np.arccos(np.sum(p * q, 1)), rtol=1e-3)


@pytest.mark.slow
def test_cloud_of_a_torus():
    torus, cloud = torus_cloud(2000)
    p, v = shots(torus, 8, 2.0)
    found = mr.geodesic(cloud, p, torus.exp(p, v))
    assert np.all(found.converged)
    np.testing.assert_allclose(found.length, 2.0, rtol=1e-3)


@pytest.mark.slow
def test_curve_in_the_plane():
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    circle = 2 * np.stack([np.cos(angle), np.sin(angle)], 1)
    p = np.array([2.0, 0.0])
    found = mr.geodesic(mr.PointCloud(circle, circle), p, -p)
    assert float(found.length) == pytest.approx(2 * np.pi, rel=1e-4)


@pytest.mark.slow
def test_folded_sheet_is_followed():
    """Two sheets, half a spacing of the fold apart: the chord would jump across."""
    t, x = np.meshgrid(np.linspace(-1, 1, 81), np.linspace(-0.2, 0.2, 9))
    bend, radius = np.pi / 0.8, 0.8 / np.pi  # a half circle for |t| < 0.4
    turn = np.clip(t, -0.4, 0.4) * bend
    beyond = np.maximum(np.abs(t) - 0.4, 0.0)
    points = np.stack(
        [x, radius * np.sin(turn), radius * np.cos(turn) - beyond], -1
    ).reshape(-1, 3)
    normals = np.stack([0 * x, np.sin(turn), np.cos(turn)], -1).reshape(-1, 3)
    cloud = mr.PointCloud(points, normals)
    found = mr.geodesic(cloud, points[4 * 81], points[4 * 81 + 80])
    assert found.converged
    assert float(found.length) == pytest.approx(2.0, rel=5e-3)


POLE, EAST = [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("p", "q", "options", "message"),
    [
        (
            [0.0, 1.0],
            POLE,
            {},
            r"p: expected shape \(..., 3\) for Sphere, found \(2,\)",
        ),
        (POLE, [0.0, np.nan, 1.0], {}, "q: 1 of 1 points hold NaN"),
        (
            POLE,
            [0.0, 0.0, 1.1],
            {},
            r"q: 1 of 1 points lie off Sphere .* M.project\(q\)",
        ),
        (np.tile(POLE, (2, 1)), np.tile(EAST, (3, 1)), {}, "do not broadcast"),
        (POLE, EAST, {"segments": 1}, "segments: must be at least 2, found 1"),
    ],
    ids=["shape", "NaN", "off", "batch", "segments"],
)
def test_bad_input(p, q, options, message):
    with pytest.raises(ValueError, match=message):
        mr.geodesic(mr.Sphere(2), np.asarray(p), np.asarray(q), **options)


def test_bad_clouds():
    cloud = sphere_cloud(320)
    with pytest.raises(ValueError, match="outside of jit and vmap"):
        jax.vmap(lambda p: mr.geodesic(cloud, p, p))(cloud.points[:3])
    both = np.concatenate([cloud.points, cloud.points + jnp.array([5.0, 0.0, 0.0])])
    apart = mr.PointCloud(both, np.tile(cloud.normals, (2, 1)))
    with pytest.raises(ValueError, match="320 of 640 points hang together"):
        mr.geodesic(apart, both[0], both[-1])


@pytest.mark.slow
def test_geodesic_loss_is_that_of_the_sphere():
    """Data far from the map: chords pull less than shortest curves do."""
    points = np.asarray(discretise(mr.Sphere(2), 250).points)
    cloud, interval = mr.PointCloud(points, points), mr.Interval(0.0, 1.0)
    x = np.linspace(0, 1, 12)
    y = np.stack([np.cos(2 * x), np.sin(2 * x), 0 * x], axis=1)
    y = y + 0.6 * np.random.default_rng(0).normal(size=y.shape)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    exact = mr.fit(interval, mr.Sphere(2), x, y, 0.1, centres=8)(x)
    gap = {
        distance: np.abs(
            mr.fit(interval, cloud, x, y, 0.1, centres=8, distance=distance)(x) - exact
        )
        for distance in ("chord", "geodesic")
    }
    assert gap["chord"].max() > 1e-2
    assert gap["geodesic"].max() < 1e-3


def test_geodesic_loss_of_a_circle_is_that_of_its_points():
    """As above in one dimension less."""
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    points = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    cloud, interval = mr.PointCloud(points, points), mr.Interval(0.0, 1.0)
    x = np.linspace(0, 1, 12)
    turn = 1.5 * x + 0.8 * np.random.default_rng(0).normal(size=12)
    y = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    slope = np.polynomial.Polynomial.fit(x, turn, 1)(x)  # lambda so large: a geodesic
    exact = np.stack([np.cos(slope), np.sin(slope)], axis=1)
    fits = {
        distance: mr.fit(interval, cloud, x, y, 100.0, centres=8, distance=distance)(x)
        for distance in ("chord", "geodesic")
    }
    assert np.abs(fits["chord"] - exact).max() > 1e-2
    assert np.abs(fits["geodesic"] - exact).max() < 1e-3


def test_geodesic_distance_needs_lambda():
    x, y = np.zeros(1), np.array([[0.0, 0, 1]])
    with pytest.raises(ValueError, match="distance: expected"):
        mr.fit(mr.Interval(0.0, 1.0), mr.Sphere(2), x, y, distance="geodesic")


def test_scans(tmp_path):
    """A file, a mesh and what `load_surface` makes of it."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.export(tmp_path / "ball.obj")
    p, q = np.asarray(ball.vertices)[[0, 15]]
    scans = (tmp_path / "ball.obj", ball, mr.load_surface(ball))
    lengths = [mr.geodesic(scan, p, q).length for scan in scans]
    np.testing.assert_allclose(lengths, np.arccos(p @ q), rtol=0.02)
    np.testing.assert_allclose(lengths, lengths[0], rtol=1e-4)
