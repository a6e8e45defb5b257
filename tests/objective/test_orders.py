"""Energies of orders one to four: exact values, other splines, other solvers, limits."""

# pyright: reportArgumentType=false

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from curves import INTERVAL, TIMES, X, curve_problem, sphere_data
from riemannian_splines import smoothing_spline
from scipy.spatial.transform import Rotation

import manireg as mr
from manireg._discretisation.domain import discretise, with_second_forms

SPHERE, LINE = mr.Sphere(2), mr.Euclidean(1)
exact = lambda value: pytest.approx(value, rel=1e-6)
zero = pytest.approx(0, abs=1e-16)


def great_circle(angle):
    def map(t):
        a = angle(t)
        return jnp.stack([jnp.cos(a), 0.6 * jnp.sin(a), 0.8 * jnp.sin(a)])

    return map


@pytest.mark.parametrize(
    ("power", "order", "value"), [(3, 3, 36), (4, 3, 192), (4, 4, 576)]
)
def test_angles_along_a_great_circle(power, order, value):
    curve = great_circle(lambda t: t**power)
    assert mr.energy(mr.Interval(0, 1), SPHERE, curve, order=order) == exact(value)


def test_a_cubic_angle_has_no_energy_of_order_four():
    curve = great_circle(lambda t: t**3)
    assert mr.energy(mr.Interval(0, 1), SPHERE, curve, order=4) == zero


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_small_circles(order):
    c, w = 0.7, 2.3

    def circle(t):
        xy = jnp.sin(c) * jnp.stack([jnp.cos(w * t), jnp.sin(w * t)])
        return jnp.append(xy, jnp.cos(c))

    value = w ** (2 * order) * np.sin(c) ** 2 * np.cos(c) ** (2 * (order - 1))
    assert mr.energy(mr.Interval(0, 1), SPHERE, circle, order=order) == exact(value)


def test_moebius_maps_are_harmonic():
    """Conformal, so the energy is twice the area; order 2 by mathematics.md 4 e."""

    def dilation(p):
        below, above = 1 - p[2], 4 * (1 + p[2])
        return jnp.append(4 * p[:2], above - below) / (below + above)

    assert mr.energy(SPHERE, SPHERE, dilation, order=1) == exact(8 * np.pi)
    assert mr.energy(SPHERE, SPHERE, dilation, order=2) == exact(6 * np.pi)


def test_rotations_have_no_energy():
    turn = jnp.asarray(Rotation.from_rotvec([0.4, -1.1, 0.8]).as_matrix())
    for order in (2, 3):
        assert mr.energy(SPHERE, SPHERE, lambda p: turn @ p, order=order) == zero


def test_cubic_monomials_of_the_square():
    square = mr.Box([0, 0], [1, 1])
    cube, mixed = (lambda u: u[:1] ** 3), (lambda u: u[:1] ** 2 * u[1])
    assert mr.energy(square, LINE, cube, order=3) == exact(36)
    assert mr.energy(square, LINE, mixed, order=3) == exact(12)


HARMONICS = {
    1: lambda p: p[2],
    2: lambda p: p[0] * p[1],
    3: lambda p: p[0] * p[1] * p[2],
    4: lambda p: p[0] * p[1] * (7 * p[2] ** 2 - jnp.sum(p**2)),
}


@pytest.mark.parametrize("degree", HARMONICS)
def test_spherical_harmonics(degree):
    f, L = HARMONICS[degree], degree * (degree + 1)
    rule = SPHERE.exact_rule(1024)
    assert rule is not None
    points, weights = rule
    size = weights @ np.asarray(jax.vmap(f)(jnp.asarray(points))) ** 2
    value = L * (L**2 - 3 * L + 10 / 3) * size
    energy = mr.energy(SPHERE, LINE, lambda p: f(p)[None], 1024, order=3)
    assert energy == exact(value)


def test_spherical_harmonics_in_a_chart():
    """The same by Christoffel symbols in colatitude and longitude, symmetrised."""
    f = HARMONICS[3]

    def in_chart(u):
        s, c = jnp.sin(u[0]), jnp.cos(u[0])
        return f(jnp.stack([s * jnp.cos(u[1]), s * jnp.sin(u[1]), c]))

    metric = lambda u: jnp.diag(jnp.stack([1.0, jnp.sin(u[0]) ** 2]))

    def christoffel(u):
        d = jax.jacfwd(metric)(u)  # d[a, b, c] = d_c g_ab
        lower = d.transpose(2, 0, 1) + d.transpose(2, 1, 0) - d.transpose(0, 1, 2)
        return jnp.einsum("ec,abc->eab", jnp.linalg.inv(metric(u)), lower) / 2

    def hessian(u):
        first = jax.grad(in_chart)(u)
        return jax.hessian(in_chart)(u) - jnp.einsum("e,eab->ab", first, christoffel(u))

    def density(u):
        gamma, h = christoffel(u), hessian(u)
        third = jax.jacfwd(hessian)(u)  # third[a, b, c] = d_c h_ab
        third -= jnp.einsum("eca,eb->abc", gamma, h)
        third -= jnp.einsum("ecb,ae->abc", gamma, h)
        axes = [(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)]
        tensor = sum(third.transpose(a) for a in axes) / 6
        up = jnp.linalg.inv(metric(u))
        raised = jnp.einsum("ad,be,cf,def->abc", up, up, up, tensor)
        return jnp.sum(raised * tensor) * jnp.sin(u[0])

    z, w = np.polynomial.legendre.leggauss(24)
    theta, turns = np.pi * (1 + z) / 2, 2 * np.pi * np.arange(16) / 16
    nodes = np.stack(np.meshgrid(theta, turns, indexing="ij"), -1).reshape(-1, 2)
    values = np.asarray(jax.vmap(density)(jnp.asarray(nodes))).reshape(24, 16)
    value = np.pi / 2 * w @ values.sum(axis=1) * 2 * np.pi / 16
    assert mr.energy(SPHERE, LINE, lambda p: f(p)[None], order=3) == exact(value)


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_waves_on_a_circle(order):
    omega = 4 * np.pi / 3
    wave = lambda x: jnp.sin(omega * x)[None]
    energy = mr.energy(mr.Circle(3.0), LINE, wave, order=order)
    assert energy == exact(1.5 * omega ** (2 * order))


def test_geodesics_of_a_chart_are_those_of_the_manifold():
    """A torus by its chart, and by its second fundamental form."""
    torus = mr.Torus(2.0, 0.7)

    class Charted(mr.AbstractSource):
        dim = 2
        point_shape = (3,)

        def chart(self, around):
            return torus.chart(around)

    f = lambda p: jnp.stack([p[0] * p[2] + p[1] ** 2])
    by_chart = mr.energy(Charted(), LINE, f, 2048, order=3)
    domain = discretise(torus, 128)
    parts = domain.points, domain.frames, domain.weights
    by_form = with_second_forms(torus, *map(np.asarray, parts), order=3)
    assert mr.energy(torus, LINE, f, by_form, order=3) == exact(float(by_chart))


def natural_spline(x, y, lam, order, times):
    """(1/k) sum (y_i - f(x_i))^2 + lam int f^(p)^2: k + p linear equations."""
    k, c = len(x), (-1) ** order / (2 * math.factorial(2 * order - 1))
    green = lambda s: c * np.abs(s[:, None] - x) ** (2 * order - 1)
    powers = lambda s: np.vander(s, order, increasing=True)
    corner = np.zeros((order, order))
    matrix = np.block(
        [[green(x) + k * lam * np.eye(k), powers(x)], [powers(x).T, corner]]
    )
    a = np.linalg.solve(matrix, np.append(y, np.zeros(order)))
    return np.hstack([green(times), powers(times)]) @ a


@pytest.mark.parametrize(
    ("order", "lam"), [(3, 1e-8), pytest.param(4, 1e-10, marks=pytest.mark.slow)]
)
def test_flat_curves_are_natural_splines(order, lam):
    """With 80 centres; with the default ones to 1e-5."""
    rng = np.random.default_rng(0)
    x = np.sort(rng.random(30))
    y = np.sin(7 * x) + 0.1 * rng.normal(size=30)
    times = np.linspace(0, 1, 201)
    expected = natural_spline(x, y, lam, order, times)
    for centres, tolerance in ((80, 1e-6), (None, 3e-5)):
        problem = mr.make_problem(
            INTERVAL, LINE, x, y[:, None], order=order, centres=centres
        )
        fitted = np.asarray(mr.solve(problem, lam, starts=(1.0,))(times))[:, 0]
        assert np.abs(fitted - expected).max() < tolerance * np.ptp(expected)


@pytest.mark.parametrize("order", [2, 3])
def test_left_out_errors_are_exact_where_data_are_nearly_met(order):
    """Against the same spline without each datum: the blocks of the inverse would have
    lost this in rounding."""
    rng = np.random.default_rng(0)
    x = np.sort(rng.random(60))
    y = np.sin(20 * x) + 0.1 * rng.normal(size=60)
    problem = mr.make_problem(INTERVAL, LINE, x, y[:, None], order=order, centres=90)
    lam = (0.03 / 2 / np.pi) ** (2 * order)
    found = np.asarray(mr.leave_one_out(problem, [lam], progress=False).scores)[:, 0]
    for i in (0, 7, 30, 59):
        rest = np.arange(60) != i
        share = lam * 60 / 59  # the same weight of each datum
        without = natural_spline(x[rest], y[rest], share, order, x[i : i + 1])[0]
        assert found[i] == pytest.approx(abs(y[i] - without), rel=2e-2)


@pytest.mark.slow
def test_flat_torus_weighs_fourier_coefficients():
    """Order 3: |k|^6."""
    torus, n = mr.FlatTorus(2), 12
    angles = np.stack(np.meshgrid(*[2 * np.pi * np.arange(n) / n] * 2), -1).reshape(
        -1, 2
    )
    x = np.concatenate([np.stack([np.cos(a), np.sin(a)], 1) for a in angles.T], 1)
    waves = {(1, 0): 1.0, (1, 1): 0.7, (2, 1): -0.5}
    wave = lambda k: np.cos(angles @ np.array(k))
    y = np.sum([c * wave(k) for k, c in waves.items()], axis=0)
    lam = 1e-4
    problem = mr.make_problem(torus, LINE, x, y[:, None], order=3, centres=256)
    fitted = np.asarray(mr.solve(problem, lam, starts=(1.0,))(x))[:, 0]
    volume = (2 * np.pi) ** 2
    damped = lambda k: 1 / (1 + lam * volume * np.sum(np.square(k)) ** 3)
    expected = np.sum([c * damped(k) * wave(k) for k, c in waves.items()], axis=0)
    assert np.abs(fitted - expected).max() < 1e-3 * np.ptp(expected)


@pytest.mark.parametrize("lam", [1e-4, pytest.param(1e-6, marks=pytest.mark.slow)])
def test_sphere_curve_is_a_riemannian_quintic(lam):
    expected = smoothing_spline(X, sphere_data(), lam, TIMES, order=3)
    fitted = mr.solve(curve_problem(SPHERE, sphere_data(), order=3), lam)(TIMES)
    assert np.abs(fitted - expected).max() < 1e-6 * np.ptp(expected)


@pytest.mark.parametrize("order", [3, pytest.param(4, marks=pytest.mark.slow)])
def test_turned_data_give_a_turned_curve(order):
    turn = Rotation.from_rotvec([0.4, -1.1, 0.8]).as_matrix()
    y, lam = sphere_data(), 1e-8
    make = lambda y: mr.make_problem(INTERVAL, SPHERE, X, y, order=order, centres=24)
    fitted = mr.solve(make(y), lam)(TIMES)
    turned = mr.solve(make(y @ turn.T), lam)(TIMES)
    np.testing.assert_allclose(turned, fitted @ turn.T, atol=1e-6)


@pytest.mark.parametrize("order", [3, 4])
def test_large_lambda_leaves_polynomials(order):
    """With many centres large lambdas make order four singular."""
    y = sphere_data()[:, :1]
    problem = mr.make_problem(INTERVAL, LINE, X, y, order=order, centres=24)
    fitted = np.asarray(mr.solve(problem, 1.0)(TIMES))[:, 0]
    expected = np.polynomial.Polynomial.fit(X, y[:, 0], order - 1)(TIMES)
    np.testing.assert_allclose(fitted, expected, atol=1e-5)


@pytest.mark.slow
def test_large_lambda_leaves_no_energy():
    problem = curve_problem(SPHERE, sphere_data(), order=3)
    left = [lam * mr.solve(problem, lam).energies.energy for lam in (1e-3, 1e-1)]
    assert left[1] < 0.02 * left[0]


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 3])
def test_derivatives_and_vmap(order):
    problem = curve_problem(SPHERE, sphere_data(), order=order)
    lam, h = (0.3 / 2 / np.pi) ** (2 * order), 1e-4

    @eqx.filter_jit
    def value(log_lam, y):
        moved = eqx.tree_at(lambda p: p.y, problem, y)
        return mr.solve(moved, jnp.exp(log_lam)).energies.loss

    at, y = jnp.log(lam), problem.y
    slope = jax.grad(value)(at, y)
    assert slope == pytest.approx(
        float(value(at + h, y) - value(at - h, y)) / 2 / h, rel=1e-4
    )
    step = SPHERE.tangent_projection(y, 0 * y + jnp.array([0.3, -0.5, 0.2]))
    along = jnp.sum(jax.grad(value, argnums=1)(at, y) * step)
    ends = [value(at, SPHERE.exp(y, s * step)) for s in (h, -h)]
    assert along == pytest.approx(float(ends[0] - ends[1]) / 2 / h, rel=1e-4)
    both = jax.vmap(lambda a: value(a, y))(jnp.stack([at, at + 1]))
    np.testing.assert_allclose(both, [value(at, y), value(at + 1, y)], rtol=1e-8)


def test_what_a_source_and_a_target_allow():
    x, y = np.random.default_rng(0).random((20, 4)), np.zeros((20, 1))
    make = lambda m, order: mr.make_problem(
        mr.Box([0] * m, [1] * m), LINE, x[:, :m], y, order=order
    )
    with pytest.raises(ValueError, match="order: Box has dimension 2.*Take `order=2`"):
        make(2, 1)
    with pytest.raises(ValueError, match="order: Box has dimension 4.*Take `order=3`"):
        make(4, 2)
    with pytest.raises(ValueError, match="order: at most 3 from Box"):
        make(2, 4)
    with pytest.raises(ValueError, match="order: expected 1, 2, 3 or 4, found 5"):
        make(2, 5)
    with pytest.raises(ValueError, match="5 distinct inputs are too few.*at least 6"):
        mr.make_problem(mr.Box([0, 0], [1, 1]), LINE, x[:5, :2], y[:5], order=3)
    with pytest.raises(ValueError, match="3 distinct inputs are too few.*at least 4"):
        mr.make_problem(INTERVAL, LINE, x[:3, 0], y[:3], order=4)
    with pytest.raises(ValueError, match="tension: only for order 2"):
        source = mr.Ambient(SPHERE)
        p = SPHERE.random_points(jax.random.key(0), 20)
        mr.make_problem(source, SPHERE, p, p, order=3, tension=1.0)
    with pytest.raises(
        ValueError, match="method: 'penalty' is the paper's, for order 2"
    ):
        mr.solve(curve_problem(SPHERE, sphere_data(), order=3), 1.0, method="penalty")


@pytest.mark.slow
def test_quadratics_of_four_variables():
    """Order 3 is the least there, and they have no energy of it."""
    x = np.random.default_rng(0).random((120, 4))
    y = x[:, :1] ** 2 + x[:, 1:2] * x[:, 2:3]
    model = mr.fit(mr.Box([0] * 4, [1] * 4), LINE, x, y, 1e-6, order=3)
    assert model.energies.loss < 1e-20 and model.energies.energy < 1e-16
