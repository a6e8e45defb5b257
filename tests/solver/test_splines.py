"""Fits against classical splines, each computed another way; and what a curve's problem
has to satisfy."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from curves import CENTRES, INTERVAL, TIMES, X, curve_problem, sphere_data
from numpy.polynomial.legendre import legval
from riemannian_splines import geodesic, geodesic_regression, smoothing_spline
from scipy.interpolate import BSpline, make_smoothing_spline
from scipy.spatial.transform import Rotation

import manireg as mr
from manireg._discretisation.domain import discretise
from manireg._objective.assemble import assemble_problem
from manireg._objective.hessian import exact, gauss_newton
from manireg._objective.objective import objective
from manireg._objective.sites import Stage
from manireg._solver.linear import direct_solvers
from manireg._solver.starts import free_solution

TORUS = mr.FlatTorus(2, jnp.array([1.0, 2.0]))
ROTATIONS = mr.manifolds.SpecialOrthogonal(3)
LOGARITHMS = mr.manifolds.SymmetricPositiveDefinite(2)
WAVES = np.stack([2 * X + np.sin(5 * X), np.cos(4 * X), X**2, np.exp(-X)], axis=1)


def in_the_plane(y):
    return y[:, :2]


def on_the_cylinder(y):
    return np.stack([1.5 * np.cos(y[:, 0]), 1.5 * np.sin(y[:, 0]), y[:, 1]], axis=1)


def on_the_flat_torus(y):
    circles = [
        (r * np.cos(a), r * np.sin(a)) for r, a in zip([1, 2], y.T, strict=False)
    ]
    return np.concatenate(circles).T


def symmetric_logarithms(y):
    return np.stack([y[:, [0, 1]], y[:, [1, 2]]], axis=1)


@pytest.mark.parametrize(
    ("target", "points_of"),
    [
        (mr.Euclidean(2), in_the_plane),
        pytest.param(mr.Cylinder(1.5), on_the_cylinder, marks=pytest.mark.slow),
        pytest.param(TORUS, on_the_flat_torus, marks=pytest.mark.slow),
        pytest.param(LOGARITHMS, symmetric_logarithms, marks=pytest.mark.slow),
    ],
    ids=["euclidean", "cylinder", "flat_torus", "spd"],
)
def test_flat_targets_are_smoothing_splines(target, points_of):
    """Unrolled coordinates of a flat target are scipy's splines (mathematics.md 5.1)."""
    lam = 1e-3
    model = mr.solve(curve_problem(target, points_of(WAVES)), lam)
    times = TIMES[(TIMES > X[0]) & (TIMES < X[-1])]
    splines = [make_smoothing_spline(X, y, lam=len(X) * lam)(times) for y in WAVES.T]
    expected = points_of(np.stack(splines, axis=1))
    difference = np.abs(model(times) - expected)
    assert difference.max() < 1e-6 * np.ptp(expected)
    assert np.abs(model(X) - points_of(WAVES)).max() > 1e-2  # no interpolation


@pytest.fixture(scope="module")
def sphere_problem():
    return curve_problem(mr.Sphere(2), sphere_data())


@pytest.mark.parametrize("lam", [3e-3, 1e-4])
def test_sphere_curve_is_a_riemannian_cubic(sphere_problem, lam):
    expected = smoothing_spline(X, sphere_data(), lam, TIMES)
    fitted = mr.solve(sphere_problem, lam)(TIMES)
    assert np.abs(fitted - expected).max() < 1e-6 * np.ptp(expected)


@pytest.fixture(scope="module")
def rotation_fit():
    y = Rotation.from_quat(sphere_data(3)).as_matrix()
    return y, mr.solve(curve_problem(ROTATIONS, y), 3e-3)(TIMES)


@pytest.mark.slow
def test_rotation_curve_is_a_riemannian_cubic_of_quaternions(rotation_fit):
    """SO(3) is S^3 / {+-1} with a metric 8 times as large, so both have one minimiser."""
    expected = smoothing_spline(X, sphere_data(3), 3e-3, TIMES)
    expected = Rotation.from_quat(expected).as_matrix()
    assert np.abs(rotation_fit[1] - expected).max() < 1e-6 * np.ptp(expected)


@pytest.mark.slow
def test_turned_rotations_give_a_turned_curve(rotation_fit):
    """R -> A R B is an isometry of SO(3)."""
    y, fitted = rotation_fit
    a, b = Rotation.from_rotvec([[1.0, 2.0, 0.5], [-0.4, 0.3, 2.0]]).as_matrix()
    turned = mr.solve(curve_problem(ROTATIONS, a @ y @ b), 3e-3)(TIMES)
    np.testing.assert_allclose(turned, a @ fitted @ b, atol=1e-6)


def test_large_lambda_is_geodesic_regression(sphere_problem):
    expected = geodesic(*geodesic_regression(X, sphere_data()), TIMES)
    gaps = []
    for lam in (10.0, 100.0):
        gaps.append(np.abs(mr.solve(sphere_problem, lam)(TIMES) - expected).max())
    assert gaps[0] < 1e-4
    assert gaps[0] / gaps[1] == pytest.approx(10, rel=0.05)


@pytest.mark.slow
def test_gauss_newton_is_exact_at_a_perfect_fit(sphere_problem):
    angle = 2 * jnp.asarray(X)
    y = jnp.stack([jnp.cos(angle), 0.6 * jnp.sin(angle), 0.8 * jnp.sin(angle)], axis=1)
    problem = eqx.tree_at(lambda p: p.y, sphere_problem, y)
    w = mr.solve(problem, 1e-2).coefficients
    stage = Stage(problem, 1e-2, 0.1, problem.energy)
    model, hessian = (
        np.asarray(h(w, stage).as_matrix()) for h in (gauss_newton, exact)
    )
    assert np.abs(model - hessian).max() < 1e-4 * np.abs(hessian).max()
    away = w + 0.01 * jax.random.normal(jax.random.key(0), w.shape)
    model, hessian = (h(away, stage).as_matrix() for h in (gauss_newton, exact))
    assert np.abs(model - hessian).max() > 1e-3 * np.abs(hessian).max()


def test_weight_two_is_a_datum_twice():
    sphere, y = mr.Sphere(2), jnp.asarray(sphere_data())
    twice = np.array([1, 2, 1, 1, 3, 1, 1, 2])
    weighted = curve_problem(sphere, y, weights=twice)
    repeated = assemble_problem(
        INTERVAL,
        sphere,
        weighted.basis,
        discretise(INTERVAL, CENTRES),
        jnp.repeat(jnp.asarray(X)[:, None], twice, axis=0),
        jnp.repeat(y, twice, axis=0),
        jnp.ones(twice.sum()),
    )
    w = eqx.filter_jit(free_solution)(weighted, 1e-3, direct_solvers(weighted))
    both = eqx.filter_jit(jax.value_and_grad(objective, has_aux=True))
    problems = (weighted, repeated, curve_problem(sphere, y))
    values = [both(w, Stage(p, 1e-3, 0.1, p.energy)) for p in problems]
    values = [(value, gradient) for (value, _), gradient in values]
    np.testing.assert_allclose(values[0][0], values[1][0], rtol=1e-13)
    np.testing.assert_allclose(values[0][1], values[1][1], atol=1e-13)
    assert abs(values[0][0] / values[2][0] - 1) > 1e-2


@pytest.mark.slow
def test_function_on_the_sphere_is_the_harmonic_spline():
    """Kernel of mathematics.md 5.3, summed to degree 300."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(60, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.sin(2 * x[:, 0]) + x[:, 1] * x[:, 2] + 0.2 * rng.normal(size=60)
    lam = 1e-3
    degrees = np.arange(1, 301)
    L = degrees * (degrees + 1.0)
    series = np.concatenate([[0], (2 * degrees + 1) / (4 * np.pi * L * (L - 1))])
    kernel = lambda a, b: legval(np.clip(a @ b.T, -1, 1), series)
    k = len(x)
    system = np.block(
        [[kernel(x, x) + k * lam * np.eye(k), np.ones((k, 1))], [np.ones((1, k)), 0]]
    )
    *weights, constant = np.linalg.solve(system, np.append(y, 0))
    new = rng.normal(size=(200, 3))
    new /= np.linalg.norm(new, axis=1, keepdims=True)
    expected = kernel(new, x) @ weights + constant
    model = mr.fit(mr.Sphere(2), mr.Euclidean(1), x, y[:, None], lam, centres=90)
    assert np.abs(model(new)[:, 0] - expected).max() < 2e-3 * np.ptp(expected)


def bspline_plate(x, y, lam, new, panels=16):
    """Thin plate on [0, 1]^2 with free edges: tensor B-splines of degree 5, Galerkin."""
    degree, nodes = 5, 8
    knots = np.linspace(0, 1, panels + 1)
    padded = np.concatenate([np.zeros(degree), knots, np.ones(degree)])
    gauss, weights = np.polynomial.legendre.leggauss(nodes)
    at = (knots[:-1, None] + (1 + gauss) / (2 * panels)).ravel()
    w = np.tile(weights / (2 * panels), panels)
    count = panels + degree

    def values(points, derivative=0):
        return BSpline(padded, np.eye(count), degree)(points, nu=derivative)

    gram = [values(at, r).T @ (w[:, None] * values(at, r)) for r in range(3)]
    energy = np.kron(gram[2], gram[0]) + 2 * np.kron(gram[1], gram[1])
    energy += np.kron(gram[0], gram[2])
    design = lambda p: np.einsum(
        "ki,kj->kij", values(p[:, 0]), values(p[:, 1])
    ).reshape(len(p), -1)
    A = design(x)
    matrix = A.T @ A / len(x) + lam * energy
    return design(new) @ np.linalg.solve(matrix, A.T @ y / len(x))


@pytest.fixture(scope="module")
def plate():
    x = np.random.default_rng(5).uniform(size=(50, 2))
    y = np.stack(
        [np.sin(3 * x[:, 0]) * np.cos(4 * x[:, 1]), x @ [2.0, -1.0] + 3], axis=1
    )
    box = mr.Box([0, 0], [1, 1])
    return x, y, mr.fit(box, mr.Euclidean(2), x, y, 1e-4, centres=150)


@pytest.mark.slow
def test_box_is_a_thin_plate_with_free_edges(plate):
    x, y, model = plate
    new = np.random.default_rng(6).uniform(size=(300, 2))
    expected = bspline_plate(x, y[:, 0], 1e-4, new)
    assert np.abs(model(new)[:, 0] - expected).max() < 2e-3 * np.ptp(expected)
    assert np.abs(model(x)[:, 0] - y[:, 0]).max() > 1e-2


@pytest.mark.slow
def test_affine_data_are_reproduced(plate):
    _, _, model = plate
    corners = np.array([[0.0, 0], [1, 0], [0, 1], [1, 1]])
    np.testing.assert_allclose(model(corners)[:, 1], [3, 5, 2, 4], atol=1e-9)


@pytest.mark.slow
def test_sphere_to_sphere_finds_a_rotation():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(30, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    turn = Rotation.from_rotvec([2.0, -0.5, 1.0]).as_matrix()
    model = mr.fit(mr.Sphere(2), mr.Sphere(2), x, x @ turn.T, 1.0, centres=50)
    assert model.energies.eells < 1e-8
    new = rng.normal(size=(100, 3))
    new /= np.linalg.norm(new, axis=1, keepdims=True)
    np.testing.assert_allclose(model(new), new @ turn.T, atol=1e-8)


@pytest.mark.slow
def test_strip_rolls_onto_a_cylinder():
    """Isometric data, so no energy; the rolled strip is represented to basis accuracy."""
    strip = mr.Box([0, -1], [3, 1])
    x = np.random.default_rng(0).uniform([0, -1], [3, 1], (40, 2))
    roll = lambda u: np.stack([np.cos(u[:, 0]), np.sin(u[:, 0]), u[:, 1]], axis=1)
    model = mr.fit(strip, mr.Cylinder(), x, roll(x), 1e-2, centres=60)
    new = np.random.default_rng(1).uniform([0, -1], [3, 1], (100, 2))
    np.testing.assert_allclose(model(new), roll(new), atol=1e-3)
    assert model.energies.eells < 1e-3
