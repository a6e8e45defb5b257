"""Hyperbolic space and affine-invariant tensors: targets and sources whose metric is not
that of the ambient space, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

import manireg as mr
from manireg._discretisation.domain import discretise

PLANE = mr.Hyperbolic(2)
TENSORS = mr.AffineInvariantSPD(3)
INTERVAL = mr.Interval(0, 1)
TURN = np.array([[0.0, 0.0], [2.0, 0.1], [1.0, 1.5], [-0.5, 1.0]])


def definite(k, n, rng):
    a = rng.normal(size=(k, n, n))
    return a @ a.swapaxes(1, 2) + 0.1 * np.eye(n)


def test_distances_of_the_poincare_ball():
    space = mr.Hyperbolic(3, 0.7)
    rng = np.random.default_rng(0)
    u, v = (0.55 * rng.uniform(-1, 1, size=(20, 3)) for _ in range(2))
    gap = np.sum((u - v) ** 2, 1)
    inside = (1 - np.sum(u**2, 1)) * (1 - np.sum(v**2, 1))
    expected = 0.7 * np.arccosh(1 + 2 * gap / inside)
    p, q = space.from_ball(u), space.from_ball(v)
    np.testing.assert_allclose(space.squared_distance(p, q), expected**2, rtol=1e-12)
    np.testing.assert_allclose(space.to_ball(p), u, rtol=1e-12, atol=1e-15)
    with pytest.raises(
        ValueError, match="1 of 1 points do not lie inside the unit ball"
    ):
        space.from_ball([[0.8, 0.8, 0.0]])


def test_geodesics_of_the_poincare_disc_are_circles_across_its_rim():
    """A circle orthogonal to the unit circle: |c|^2 = 1 + r^2."""
    p = PLANE.from_ball(np.array([0.3, 0.4]))
    v = PLANE.tangent_projection(p, jnp.array([0.0, 1.0, -0.3]))
    curve = jax.vmap(lambda t: PLANE.to_ball(PLANE.exp(p, t * v)))(
        jnp.linspace(-2, 2, 9)
    )
    system = np.column_stack([2 * np.asarray(curve), np.ones(9)])
    right = np.sum(np.asarray(curve) ** 2, axis=1)
    (a, b, c), residual, *_ = np.linalg.lstsq(system, right, rcond=None)
    assert residual < 1e-24
    np.testing.assert_allclose(c, -1.0, rtol=1e-10)  # r^2 - |c|^2


@pytest.mark.parametrize("radius", [0.4, 2.0])
def test_small_circles_have_the_curvature_coth(radius):
    """At unit speed |Dg'| = coth r, |D^2 g'| = coth^2 r - so are the energies."""
    turn = 1 / np.sinh(radius)

    def circle(t):
        angle = t * turn
        x = np.sinh(radius) * jnp.array([jnp.cos(angle), jnp.sin(angle)])
        return jnp.concatenate([jnp.full(1, np.cosh(radius)), x])

    coth = 1 / np.tanh(radius)
    for order in (2, 3, 4):
        found = mr.energy(INTERVAL, PLANE, circle, order=order)
        np.testing.assert_allclose(found, coth ** (2 * order - 2), rtol=1e-9)


def test_distances_of_tensors_by_generalised_eigenvalues():
    rng = np.random.default_rng(0)
    a, b = definite(10, 3, rng), definite(10, 3, rng)
    p, q = TENSORS.from_matrices(a), TENSORS.from_matrices(b)
    logs = [np.log(scipy.linalg.eigh(t, s, eigvals_only=True)) for s, t in zip(a, b)]
    expected = np.sum(np.square(logs), axis=1)
    np.testing.assert_allclose(TENSORS.squared_distance(p, q), expected, rtol=1e-11)
    change = np.array([[2.0, 1.0, 0.0], [0.0, -1.0, 3.0], [0.5, 0.0, 1e-3]])
    moved = [TENSORS.from_matrices(change @ m @ change.T) for m in (a, b)]
    np.testing.assert_allclose(TENSORS.squared_distance(*moved), expected, rtol=1e-8)


def test_geodesics_of_tensors():
    """S^{1/2} (S^{-1/2} T S^{-1/2})^t S^{1/2}, by scipy."""
    rng = np.random.default_rng(0)
    a, b = definite(2, 3, rng)
    p, q = TENSORS.from_matrices(a), TENSORS.from_matrices(b)
    root = scipy.linalg.sqrtm(a)
    between = np.linalg.inv(root) @ b @ np.linalg.inv(root)
    for t in (0.3, 1.0, 1.7):
        expected = root @ scipy.linalg.fractional_matrix_power(between, t) @ root
        found = TENSORS.to_matrices(TENSORS.exp(p, t * TENSORS.log(p, q)))
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_the_metric_is_that_of_the_matrices():
    """tr(S^-1 dS S^-1 dS), dS by finite differences."""
    rng = np.random.default_rng(0)
    p = np.asarray(TENSORS.from_matrices(definite(1, 3, rng)[0]))
    v = rng.normal(size=(3, 3))
    v = v + v.T
    ahead, back = (scipy.linalg.expm(p + s * 1e-5 * v) for s in (1, -1))
    change = np.linalg.solve(scipy.linalg.expm(p), (ahead - back) / 2e-5)
    found = jnp.sum(TENSORS.orthonormal(jnp.array(p), jnp.array(v)) ** 2)
    np.testing.assert_allclose(found, np.trace(change @ change), rtol=1e-8)


@pytest.mark.slow
def test_commuting_tensors_are_log_euclidean():
    """Diagonal ones: the fits agree, and so do their regions."""
    rng = np.random.default_rng(0)
    x = np.sort(rng.uniform(size=25))
    logs = np.stack([np.sin(3 * x), x**2], axis=1) + 0.1 * rng.normal(size=(25, 2))
    y = np.eye(2) * logs[:, None]
    fits = [
        mr.fit(INTERVAL, target, x, y, 1e-4)
        for target in (mr.AffineInvariantSPD(2), mr.SymmetricPositiveDefinite(2))
    ]
    queries = np.linspace(0, 1, 9)
    ours, flat = (fit(queries) for fit in fits)
    np.testing.assert_allclose(ours, flat, atol=1e-9)
    np.testing.assert_allclose(fits[0].energies.loss, fits[1].energies.loss, rtol=1e-9)


def curve(key, k=25):
    rng = np.random.default_rng(0)
    x = np.sort(rng.uniform(size=k))
    truth = PLANE.from_ball(0.6 * np.stack([np.cos(3 * x), np.sin(3 * x)], axis=1))
    noise = 0.1 * rng.normal(size=(k, 2))
    noise = PLANE.from_orthonormal(truth, jnp.pad(jnp.array(noise), ((0, 0), (1, 0))))
    return x, PLANE.exp(truth, noise)


def test_fits_and_their_slope_in_lambda(key):
    x, y = curve(key)
    problem = mr.make_problem(INTERVAL, PLANE, x, y)
    value = lambda log_lam: mr.solve(problem, jnp.exp(log_lam))(0.3)
    log_lam, h = jnp.log(1e-4), 1e-3
    slope = jax.jacfwd(value)(log_lam)
    differences = (value(log_lam + h) - value(log_lam - h)) / (2 * h)
    np.testing.assert_allclose(slope, differences, rtol=1e-5, atol=1e-9)


def test_a_large_lambda_gives_a_geodesic(key):
    x, y = curve(key)
    model = mr.fit(INTERVAL, PLANE, x, y, 1e4)
    acceleration = PLANE.orthonormal(model(x), model.acceleration(x))
    velocity = PLANE.orthonormal(model(x), model.velocity(x))
    assert jnp.max(jnp.abs(acceleration)) < 0.01 * jnp.max(jnp.abs(velocity))


def test_isometries_move_the_fit_along(key):
    """A boost, which is far from a rotation of the ambient space. Regions only about: the
    Gauss-Newton model drops what is linear in the residuals, and that in moving frames."""
    x, y = curve(key)
    boost = scipy.linalg.expm(np.array([[0, 1.3, 0.4], [1.3, 0, 0], [0.4, 0, 0]]))
    fits = [
        mr.fit(INTERVAL, PLANE, x, data, 1e-4, centres=60) for data in (y, y @ boost)
    ]
    queries = np.linspace(0, 1, 11)
    gaps = PLANE.squared_distance(fits[0](queries) @ boost, fits[1](queries))
    assert jnp.max(gaps) < 1e-5**2
    axes = [fit.posterior("known").region(queries).semi_axes for fit in fits]
    np.testing.assert_allclose(*axes, rtol=0.04)
    speeds = [fit.posterior("known").velocity(queries).covariance for fit in fits]
    np.testing.assert_allclose(
        *(np.trace(s, axis1=1, axis2=2) for s in speeds), rtol=0.04
    )


def test_left_out_data_are_those_of_refits(key):
    x, y = curve(key)
    model = mr.fit(INTERVAL, PLANE, x, y, 1e-4)
    left_out = model.summary().each.left_out
    for i in (3, 11):
        rest = np.arange(len(x)) != i
        without = mr.make_problem(INTERVAL, PLANE, x, y, weights=rest * 1.0)
        gap = PLANE.squared_distance(mr.solve(without, 1e-4 * 25 / 24)(x[i]), y[i])
        np.testing.assert_allclose(left_out[i], gap**0.5, rtol=0.05)


def test_the_plane_as_a_source():
    """Its area, and energies of the function p_0: its Hessian is p_0 times the metric."""
    rng = np.random.default_rng(0)
    u = rng.uniform(-1, 1, (50, 2))
    u[:2] = [[-1, -1], [1, 1]]
    origin = PLANE.origin
    p = PLANE.exp(origin, jnp.pad(jnp.array(u), ((0, 0), (1, 0))))
    domain = discretise(PLANE, 200, around=np.asarray(p), order=3)
    distortion = lambda y, x: np.sinh(np.hypot(x, y)) / np.hypot(x, y)
    area = 4 * scipy.integrate.dblquad(distortion, 1e-12, 1, 0, 1)[0]
    np.testing.assert_allclose(jnp.sum(domain.weights), area, rtol=1e-6)
    height = np.asarray(domain.points[:, 0])
    expected = {2: 2 * height**2, 3: 4 / 3 * (height**2 - 1)}
    for order, density in expected.items():
        found = mr.energy(PLANE, mr.Euclidean(1), lambda p: p[:1], domain, order=order)
        np.testing.assert_allclose(found, domain.weights @ density, rtol=1e-9)
        same = mr.energy(PLANE, PLANE, lambda p: p, domain, order=order)
        assert same < 1e-20
    frame = mr.fit(PLANE, mr.Euclidean(1), p, p[:, :1], 1e-3).differential(p[5])
    inner = PLANE.orthonormal(p[5], jnp.asarray(frame.frame.T))
    np.testing.assert_allclose(inner @ inner.T, np.eye(2), atol=1e-12)


@pytest.mark.slow
def test_tensors_as_a_source():
    """The trace of S, whose Hessian is tr(S B^2) in orthonormal coordinates B."""
    tensors = mr.AffineInvariantSPD(2)
    q = tensors.random_points(jax.random.key(0), 40)
    domain = discretise(tensors, 100, around=np.asarray(q).reshape(40, -1))
    trace = lambda p: jnp.trace(jax.scipy.linalg.expm(p))[None]
    found = mr.energy(tensors, mr.Euclidean(1), trace, domain)
    axes = [np.diag([1.0, 0.0]), np.diag([0.0, 1.0]), np.eye(2)[::-1] / 2**0.5]
    S = np.asarray(tensors.to_matrices(domain.points.reshape(-1, 2, 2)))
    product = np.array([[(a @ b + b @ a) / 2 for b in axes] for a in axes])
    hessian = np.einsum("qij,abji->qab", S, product)
    expected = np.asarray(domain.weights) @ np.sum(hessian**2, axis=(1, 2))
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert mr.energy(tensors, tensors, lambda p: p, domain) < 1e-20


def test_what_needs_the_metric_of_the_ambient_space_says_so(key):
    x, y = curve(key)
    problem = mr.make_problem(INTERVAL, PLANE, x, y)
    with pytest.raises(ValueError, match="method: 'penalty' measures in the ambient"):
        mr.solve(problem, 1e-4, method="penalty")
    with pytest.raises(ValueError, match="Hyperbolic has a metric of its own"):
        mr.Ambient(PLANE)
    ball = mr.Ambient(mr.Sphere(2))
    points = mr.Sphere(2).random_points(key, 25)
    with pytest.raises(
        ValueError, match="energy: AmbientEnergy measures in the ambient"
    ):
        mr.make_problem(ball, PLANE, points, y)
    lower = y.at[0].multiply(-1.0)
    with pytest.raises(ValueError, match="lie on the lower sheet of Hyperbolic"):
        mr.make_problem(INTERVAL, PLANE, x, lower)


@pytest.mark.parametrize(
    "target", [PLANE, mr.Hyperbolic(2, 0.3), mr.PlanarShapes(TURN)]
)
def test_shortest_curves_have_the_length_of_the_metric(target, key):
    p, q = target.random_points(key, 2)
    found = mr.geodesic(target, p, q, segments=8)
    length = target.squared_distance(p, q) ** 0.5
    np.testing.assert_allclose(found.length, length, rtol=1e-9)
    np.testing.assert_allclose(found.points[-1], q, atol=1e-9)
    steps = target.squared_distance(found.points[1:], found.points[:-1]) ** 0.5
    np.testing.assert_allclose(steps, length / 8, rtol=1e-6)
    assert found.converged


def test_geodesic_regression_measures_in_the_metric(key):
    """The least sum of squared distances: no nearby geodesic has less."""
    x, y = curve(key)
    found = mr.baselines.geodesic_regression(INTERVAL, PLANE, x, y)
    mean_square = lambda fitted: float(jnp.mean(PLANE.squared_distance(fitted, y)))
    least = mean_square(found(x))
    np.testing.assert_allclose(found.loss, least, rtol=1e-6)
    p, q = found(0.0), found(1.0)
    for i in range(6):
        moves = 1e-3 * jax.random.normal(jax.random.fold_in(key, i), (2, 3))
        ends = [PLANE.project(end + move) for end, move in zip((p, q), moves)]
        other = mr.geodesic(PLANE, *ends, segments=2).velocity
        line = jax.vmap(lambda t, p=ends[0], v=other: PLANE.exp(p, t * v))(jnp.array(x))
        assert mean_square(line) > least


@pytest.mark.slow
def test_energies_of_maps_from_the_plane_are_those_of_any_map(key):
    """The basis against autodiff: of the fit itself, at the same points."""
    rng = np.random.default_rng(0)
    u = jnp.pad(jnp.array(rng.uniform(-1, 1, (60, 2))), ((0, 0), (1, 0)))
    p = PLANE.exp(PLANE.origin, u)
    y = jnp.sin(3 * p[:, 1:2]) + p[:, :1]
    model = mr.fit(PLANE, mr.Euclidean(1), p, y, 1e-4, centres=48)
    domain = discretise(PLANE, 48, around=np.asarray(p))
    found = mr.energy(PLANE, mr.Euclidean(1), model, domain)
    np.testing.assert_allclose(found, model.energies.eells, rtol=1e-6)
    np.testing.assert_allclose(
        jnp.mean((model(p) - y) ** 2), model.energies.loss, rtol=1e-9
    )
