"""Centres and quadrature follow the data where those cluster, and only there."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator, make_smoothing_spline

import manireg as mr
from manireg._discretisation.domain import discretise
from manireg._discretisation.following import follow
from manireg._discretisation.local_spacing import clustered_spacing, spacings_of
from manireg._discretisation.sampling import DEFAULT_CENTRES
from manireg._programs.sizes import bucket

LINE = mr.Euclidean(1)
BURSTS = np.concatenate([21600.0 * i + np.arange(60) for i in range(6)])
DAY = mr.Interval(BURSTS[0], BURSTS[-1])


def directions(latitude, longitude):
    a, b = np.radians(latitude), np.radians(longitude)
    return np.stack([np.cos(a) * np.cos(b), np.cos(a) * np.sin(b), np.sin(a)], axis=-1)


def stations(seed, k):
    """In 5 x 7 degrees."""
    rng = np.random.default_rng(seed)
    return rng.uniform(45, 50, k), rng.uniform(5, 12, k)


def spacing_for(source, x):
    x = jnp.asarray(x, float).reshape(len(x), -1)
    low, high = DEFAULT_CENTRES[source.dim]
    n = int(np.clip(len(x), low, high))
    volume = float(jnp.sum(discretise(source, n, x).weights))
    return clustered_spacing(np.asarray(x), source.dim, volume, n, low)


def followed(source, x, n=400, finer=False):
    x = jnp.asarray(x, float).reshape(len(x), -1)
    spacing = spacing_for(source, x)
    assert spacing is not None
    found = follow(source, spacing, n, x, finer, order=2)
    assert found is not None
    return found


@pytest.mark.parametrize("k", [30, 100, 500])
def test_random_uniform_data_are_even(k):
    for seed in range(100):
        rng = np.random.default_rng(seed)
        line, box, sphere = (rng.random((k, m)) for m in (1, 2, 2))
        z, longitude = 2 * sphere[:, 0] - 1, 360 * sphere[:, 1]
        sphere = directions(np.degrees(np.arcsin(z)), longitude)
        evenly = (line, 1.0), (box * [1, 3], 3.0), (sphere, 4 * np.pi)
        for x, volume in evenly:
            m = min(2, x.shape[1])
            low, high = DEFAULT_CENTRES[m]
            n = int(np.clip(k, low, high))
            assert clustered_spacing(x, m, volume, n, low) is None


def test_even_data_have_even_centres():
    x = np.random.default_rng(0).random(40)
    problem = mr.make_problem(mr.Interval(0, 1), LINE, x, x[:, None])
    assert len(problem.basis.centres) == 49  # 48 spacings, of 32, 48, 64, 96
    assert np.all(problem.basis.widths == problem.basis.widths[0])
    assert np.isclose(problem.data_volume, 1)


CLUSTERED = {
    "a tenth": (mr.Interval(0, 10), np.linspace(3, 4, 80)),
    "log times": (mr.Interval(1e-3, 1e3), np.geomspace(1e-3, 1e3, 120)),
    "outlier": (mr.Interval(0, 1e4), np.append(np.linspace(0, 1, 50), 1e4)),
    "few": (mr.Interval(0, 1), np.array([0.2, 0.2001, 0.2002, 0.2003, 0.2004, 1.0])),
    "circle": (
        mr.Sphere(1),
        np.stack([np.cos(np.linspace(1, 1.2, 90)), np.sin(np.linspace(1, 1.2, 90))], 1),
    ),
    "track": (
        mr.Box([0, 0], [1, 1]),
        np.linspace(0.1, 0.9, 200)[:, None] * [1.0, 0.6],
    ),
}


@pytest.mark.parametrize("name", CLUSTERED)
def test_centres_are_as_dense_as_clustered_data(name):
    source, x = CLUSTERED[name]
    x = x.reshape(len(x), -1)
    nodes, spacings, quadrature = followed(source, x)
    assert len(nodes.points) <= 400
    points = np.asarray(nodes.points)
    distance = np.linalg.norm(points[:, None] - x, axis=2).min(axis=0)
    assert np.all(distance < 1.1 * np.maximum(spacings_of(x, source.dim), 1e-300))
    # neighbours are about as wide as each other
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    i, j = np.nonzero(apart < np.minimum(spacings[:, None], spacings))
    assert np.max(spacings[i] / spacings[j]) < 2
    volume = jnp.sum(discretise(source, 200, x).weights)
    assert np.isclose(jnp.sum(quadrature.weights), volume, rtol=1e-9)


@pytest.mark.parametrize("scale, origin", [(1e-9, 0.0), (1e9, 0.0), (1.0, 1e9)])
def test_unit_and_origin_do_not_matter(scale, origin):
    there = mr.Interval(scale * DAY.a + origin, scale * DAY.b + origin)
    (a, b, _), (c, d, _) = (
        followed(DAY, BURSTS),
        followed(there, scale * BURSTS + origin),
    )
    assert np.allclose(scale * a.points + origin, c.points, rtol=1e-9, atol=0)
    assert np.allclose(scale * b, d, rtol=1e-5)


def test_repeated_inputs_count_once():
    x = np.repeat(np.linspace(0, 1, 12), 50)
    assert spacing_for(mr.Interval(0, 1), x) is None
    source, bursts = CLUSTERED["a tenth"]
    once, often = followed(source, bursts), followed(source, np.repeat(bursts, 3))
    assert np.allclose(once.nodes.points, often.nodes.points, rtol=1e-9)


def test_number_of_centres():
    for n in (60, 150, 1000):
        nodes = followed(DAY, BURSTS, n, finer=True).nodes
        assert 0.65 * n <= len(nodes.points) <= n
        assert len(nodes.points) == bucket(len(nodes.points))


REGION = directions(*stations(0, 400))


def test_sphere_is_integrated_as_a_whole():
    """|Hess z|^2 = 2 z^2."""
    domain = followed(mr.Sphere(2), REGION).quadrature
    assert np.isclose(jnp.sum(domain.weights), 4 * np.pi, rtol=1e-4)
    energy = mr.eells_energy(mr.Sphere(2), LINE, lambda p: p[2:], domain)
    assert np.isclose(energy, 8 * np.pi / 3, rtol=1e-3)


def on_torus(u):
    rho = 2 + 0.8 * np.cos(u[:, 1])
    columns = rho * np.cos(u[:, 0]), rho * np.sin(u[:, 0]), 0.8 * np.sin(u[:, 1])
    return np.stack(columns, axis=1)


AREAS = {
    "torus": (mr.Torus(2.0, 0.8), on_torus, 4 * np.pi**2 * 1.6),
    "flat torus": (
        mr.FlatTorus(2, jnp.array([1.0, 2.0])),
        lambda u: (jnp.array([1.0, 1, 2, 2]) * np.stack(
            [np.cos(u[:, 0]), np.sin(u[:, 0]), np.cos(u[:, 1]), np.sin(u[:, 1])], 1)),
        8 * np.pi**2,
    ),
    "product": (
        mr.Product(mr.Sphere(2), mr.Euclidean(1)),
        lambda u: np.concatenate([directions(*(9 * u.T[:2])), u[:, 2:]], axis=1),
        4 * np.pi,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", AREAS)
def test_clusters_on_other_sources(name):
    source, embed, area = AREAS[name]
    u = np.random.default_rng(0).random((300, 3))
    u[:, 2] = (u[:, 2] - u[:, 2].min()) / np.ptp(u[:, 2])
    x = np.asarray(source.project(jnp.asarray(embed(0.1 * u * [1, 1, 10]))))
    nodes, spacings, quadrature = followed(source, x)
    assert np.isclose(jnp.sum(quadrature.weights), area, rtol=1e-3)
    even = (area / 300) ** (1 / source.dim)
    assert np.min(spacings) < 0.4 * even
    assert np.sum(np.asarray(quadrature.weights) < 0) == 0


@pytest.mark.slow
def test_scattered_cluster():
    """No chart: Voronoi volumes."""
    source = mr.Stiefel(3, 1)
    x = REGION[:60, :, None]
    nodes, spacings, quadrature = followed(source, x, 200)
    assert np.isclose(jnp.sum(quadrature.weights), 4 * np.pi, rtol=1e-2)
    middle = np.mean(REGION, axis=0)
    near = np.linalg.norm(np.asarray(nodes.points) - middle, axis=1) < 0.1
    assert np.sum(near) > 20
    assert np.max(spacings[near]) < 0.2 * np.max(spacings)


def test_bursts_as_a_smoothing_spline():
    truth = 0.8 * np.sin(2 * np.pi * BURSTS / 25)
    y = truth + 0.05 * np.random.default_rng(0).normal(size=BURSTS.shape)
    problem = mr.make_problem(DAY, LINE, BURSTS, y[:, None])
    assert problem.pattern.band is not None and problem.pattern.band < 12
    rms = lambda values: np.sqrt(np.mean((np.ravel(values) - truth) ** 2))
    for lam in (1e-2, 0.1):
        spline = make_smoothing_spline(BURSTS, y, lam=len(y) * lam)(BURSTS)
        fitted = np.ravel(mr.solve(problem, lam)(BURSTS))
        assert np.allclose(fitted, spline, atol=2e-3)
        assert rms(fitted) < 1.02 * rms(spline)
    grid = mr.lambda_grid(problem)
    assert grid[0] < 1e-3 and grid[-1] > 1e3 and np.max(grid[1:] / grid[:-1]) < 6


@pytest.mark.slow
def test_region_of_a_sphere_as_a_thin_plate_in_its_plane():
    field = lambda la, lo: np.sin(2 * np.pi * la / 2.5) * np.cos(2 * np.pi * lo / 4)
    at, to = stations(0, 400), stations(1, 1600)
    y = field(*at) + 0.1 * np.random.default_rng(2).normal(size=400)
    middle = directions(47.5, 8.5)
    plane = np.linalg.svd(middle[None])[2][1:].T
    flat = lambda where: (
        directions(*where) @ plane / (directions(*where) @ middle)[:, None]
    )
    rms = lambda values: np.sqrt(np.mean((np.ravel(values) - field(*to)) ** 2))
    thin_plate = lambda s: RBFInterpolator(
        flat(at), y, kernel="thin_plate_spline", smoothing=s
    )
    best = min(rms(thin_plate(s)(flat(to))) for s in np.geomspace(1e-7, 1e-3, 17))
    found = mr.cross_validate(
        mr.Sphere(2), LINE, directions(*at), y[:, None], progress=False
    )
    assert rms(found.model(directions(*to))) < 1.2 * best
