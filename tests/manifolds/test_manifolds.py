"""Manifolds against their laws and against independent truth; the laws against
manifolds that break them."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from helpers import MANIFOLDS

from manireg.manifolds import (
    AbstractManifold,
    Cylinder,
    Ellipsoid,
    Euclidean,
    FlatTorus,
    LevelSet,
    Product,
    Sphere,
    Torus,
    check_manifold,
    geodesic_exp,
    implicit_projection,
    second_form_of_projection,
    shooting_log,
)
from manireg.manifolds._defaults.covariant_derivative import covariant_derivative

SLOW = (  # to compile
    *("torus", "ellipsoid", "quartic", "curve"),
    *("so2", "so3", "so4", "se3", "stiefel", "shapes", "affine_spd"),
)
AXES = np.array([1.0, 1.5, 2.0])


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name in SLOW else ())
        for name in MANIFOLDS
    ],
)
def test_laws(name, key):
    manifold = MANIFOLDS[name]
    shoots = name in ("torus", "ellipsoid", "quartic", "curve", "stiefel")
    up_to = 0.9 if shoots else 0.999
    points = manifold.random_points(key, 5)
    report = check_manifold(manifold, points, log_up_to=up_to)
    assert max(report.values()) < 1e-7


SIZES = {
    "circle": lambda size: Sphere(1, size),
    "sphere": lambda size: Sphere(2, size),
    "flat_torus": lambda size: FlatTorus(2, size * jnp.array([1.0, 2.0])),
    "cylinder": Cylinder,
    "torus": lambda size: Torus(2.0 * size, 0.8 * size),
    "ellipsoid": lambda size: Ellipsoid(size * AXES),
}


@pytest.mark.parametrize("size", [1e-9, 1e9])
@pytest.mark.parametrize(
    "name",
    [pytest.param(k, marks=pytest.mark.slow if k in SLOW else ()) for k in SIZES],
)
def test_laws_in_any_unit(name, size, key):
    manifold = SIZES[name](size)
    points = size * SIZES[name](1.0).random_points(key, 3)
    report = check_manifold(manifold, points)
    assert max(report.values()) < 1e-7


MIXED = FlatTorus(2, jnp.array([1e-9, 1.0]))
CUTS = {  # two points of the cut locus of each other, and their distance
    "circle": (Sphere(1, 2.0), [2.0, 0.0], [-2.0, 0.0], 2 * np.pi),
    "poles": (Sphere(2), [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], np.pi),
    "small": (
        Sphere(2, 1e-9),
        [0.0, 6e-10, 8e-10],
        [0.0, -6e-10, -8e-10],
        1e-9 * np.pi,
    ),
    "large": (Sphere(3, 1e9), [6e8, 0, 8e8, 0], [-6e8, 0, -8e8, 0], 1e9 * np.pi),
    "cylinder": (Cylinder(2.0), [2.0, 0, 1], [-2.0, 0, 4], np.hypot(2 * np.pi, 3)),
    "one angle": (FlatTorus(2), [1.0, 0, 1, 0], [0.6, 0.8, -1, 0], None),
    "both": (MIXED, [1e-9, 0, 0, 1], [-1e-9, 0, 0, -1], np.hypot(1, 1e-9) * np.pi),
}


@pytest.mark.parametrize("name", CUTS)
def test_logarithms_at_the_cut_locus(name):
    """A geodesic of the right length, whose end is q: also under jit and vmap, and with
    finite gradients of the loss."""
    manifold, p, q, distance = CUTS[name]
    p, q = jnp.asarray(p, float), jnp.asarray(q, float)
    distance = distance or np.hypot(np.pi, np.arccos(0.6))
    log = eqx.filter_jit(jax.vmap(lambda p, q: manifold.log(p, q)))
    for v in (manifold.log(p, q), log(p[None], q[None])[0]):
        np.testing.assert_allclose(jnp.linalg.norm(v), distance, rtol=1e-14)
        tangent = manifold.tangent_projection(p, v)
        np.testing.assert_allclose(tangent, v, rtol=1e-12, atol=1e-99)
        gap = manifold.exp(p, v) - q
        assert jnp.max(jnp.abs(gap)) < 1e-14 * distance
    loss = jax.value_and_grad(manifold.squared_distance, argnums=1)
    assert all(jnp.all(jnp.isfinite(x)) for x in loss(p, q))
    slopes = jax.jacfwd(manifold.log, (0, 1))(p, q)
    assert all(jnp.all(jnp.isfinite(x)) for x in slopes)


@pytest.mark.parametrize("short", [0.3, 1e-3, 1e-7, 1e-11])
@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_logarithms_close_to_the_antipode(short, size):
    """At an angle of pi - short, from the sine of the rest."""
    manifold = Sphere(2, size)
    turn = np.array([-np.cos(short), 0.6 * np.sin(short), 0.8 * np.sin(short)])
    v = manifold.log(size * jnp.array([1.0, 0, 0]), size * jnp.asarray(turn))
    expected = (np.pi - short) * np.array([0.0, 0.6, 0.8])
    np.testing.assert_allclose(v / size, expected, atol=1e-14)
    squared = manifold.squared_distance(size * jnp.eye(3)[0], size * jnp.asarray(turn))
    slope, edge = (
        (np.pi - 0.05) / np.sin(np.pi - 0.05),
        np.pi - 0.05,
    )  # the loss, as ever
    continued = edge**2 + slope * 2 * (np.cos(edge) + np.cos(short))
    expected = (np.pi - short) ** 2 if short > 0.05 else continued
    np.testing.assert_allclose(squared / size**2, expected, rtol=1e-12)


MEDIAL = [  # a point as close to many, one of these, and its distance
    (Sphere(2, 3.0), [0.0, 0, 0], [3.0, 0, 0], 3.0),
    (Sphere(1, 1e-9), [0.0, 0], [1e-9, 0], 1e-9),
    (Cylinder(2.0), [0.0, 0, 5], [2.0, 0, 5], 2.0),
    (FlatTorus(2, jnp.array([1.0, 2.0])), [0.0, 0, 0, 7], [1.0, 0, 0, 2], np.sqrt(26)),
    (Torus(2.0, 0.8), [1.2, 1.6, 0], [1.68, 2.24, 0], 0.8),
    (Torus(2.0, 0.8), [2 * np.cos(1), 2 * np.sin(1), 0], None, 0.8),
    (Torus(2.0, 0.8), [0.0, 0, 0], [1.2, 0, 0], 1.2),
    (Torus(2e9, 8e8), [0.0, 0, 1.5e9], [1.36e9, 0, 4.8e8], 1.7e9),
    (Ellipsoid(AXES), [0.0, 0, 0], [1.0, 0, 0], 1.0),
    (Ellipsoid(1e-9 * AXES), [0.0, 0, 0], [1e-9, 0, 0], 1e-9),
    (Ellipsoid(AXES), [0, 0.5, 0.75], [np.sqrt(0.39), 0.9, 1.0], np.sqrt(0.6125)),
    (Ellipsoid([1.0, 1.0, 2.0]), [0.0, 0, 0], [0.5**0.5, 0.5**0.5, 0], 1.0),
]


@pytest.mark.parametrize("manifold, x, closest, distance", MEDIAL)
def test_projections_of_the_medial_axis(manifold, x, closest, distance):
    x = jnp.asarray(x, float)
    y = manifold.project(x)
    if closest is not None:
        size = np.max(np.abs(closest))
        np.testing.assert_allclose(y, closest, atol=1e-14 * size)
    np.testing.assert_allclose(jnp.linalg.norm(y - x), distance, rtol=1e-14)
    np.testing.assert_allclose(manifold.project(y), y, rtol=1e-14, atol=1e-90)
    assert jnp.all(jnp.isfinite(manifold.tangent_projection(x, jnp.ones_like(x))))


def derivatives(function, orders=3):
    """Derivatives at 0 of a function of one number, by automatic differentiation."""
    chain = [function]
    for _ in range(orders):
        chain.append(lambda t, f=chain[-1]: jax.jvp(f, (t,), (jnp.ones_like(t),))[1])
    return jax.jit(lambda t: jnp.stack([f(t) for f in chain[1:]]))(jnp.zeros(()))


def differences(function, orders=3, h=0.02):
    """The same from the values at 11 points (error of order h^8 or better)."""
    nodes = h * np.arange(-5, 6)
    values = np.asarray(jax.jit(jax.vmap(function))(jnp.asarray(nodes)))
    powers = np.vander(nodes / h, increasing=True)
    coefficients = np.linalg.solve(powers, values.reshape(11, -1))[1 : orders + 1]
    scale = np.cumprod(np.arange(1, orders + 1) / h)
    return (scale[:, None] * coefficients).reshape(orders, *values.shape[1:])


@pytest.mark.parametrize("offset", [0.0, 0.1])
@pytest.mark.parametrize("name", ["torus", "ellipsoid", "quartic", "flat_torus"])
def test_three_derivatives_of_the_projection(name, offset, key):
    manifold = MANIFOLDS[name]
    p = manifold.random_points(key, 1)[0] * (1.0 + offset)
    u = jax.random.normal(jax.random.key(1), p.shape) / 4
    line = lambda t: manifold.project(p + t * u)
    np.testing.assert_allclose(derivatives(line), differences(line), atol=1e-7)


def geodesic_in_chart(chart, u, du):
    """Point at time 1 of the geodesic of a parametrised surface, from the equation
    <X_i, X_jk> u'^j u'^k + g_ij u''^j = 0 with derivatives of X written by hand."""

    def slope(_, state):
        u, du = state[:2], state[2:]
        _, first, second = chart(u)
        force = np.einsum("ia,jka,j,k->i", first, second, du, du)
        return np.concatenate([du, -np.linalg.solve(first @ first.T, force)])

    solution = scipy.integrate.solve_ivp(
        slope, (0, 1), np.concatenate([u, du]), "DOP853", rtol=1e-12, atol=1e-13
    )
    x, first, _ = chart(u)
    return x, du @ first, chart(solution.y[:2, -1])[0]


def torus_chart(u, major=2.0, minor=0.8):
    (st, ct), (sp, cp) = ((np.sin(a), np.cos(a)) for a in u)
    rho = major + minor * ct
    x = np.array([rho * cp, rho * sp, minor * st])
    x_t = np.array([-minor * st * cp, -minor * st * sp, minor * ct])
    x_p = np.array([-rho * sp, rho * cp, 0])
    x_tt = np.array([-minor * ct * cp, -minor * ct * sp, -minor * st])
    x_tp = np.array([minor * st * sp, -minor * st * cp, 0])
    x_pp = np.array([-rho * cp, -rho * sp, 0])
    return x, np.array([x_t, x_p]), np.array([[x_tt, x_tp], [x_tp, x_pp]])


def ellipsoid_chart(u):
    (st, ct), (sp, cp) = ((np.sin(a), np.cos(a)) for a in u)
    x_t, x_p = np.array([ct * cp, ct * sp, -st]), np.array([-st * sp, st * cp, 0])
    x_tt, x_tp = -np.array([st * cp, st * sp, ct]), np.array([-ct * sp, ct * cp, 0])
    x_pp = -np.array([st * cp, st * sp, 0])
    x = np.array([st * cp, st * sp, ct])
    second = np.array([[x_tt, x_tp], [x_tp, x_pp]])
    return AXES * x, AXES * np.array([x_t, x_p]), AXES * second


@pytest.mark.parametrize(
    "name, chart", [("torus", torus_chart), ("ellipsoid", ellipsoid_chart)]
)
def test_geodesics_against_an_ode_solver_in_a_chart(name, chart):
    start, velocity = np.array([0.7, 0.4]), np.array([0.6, 0.8])
    p, v, q = (jnp.asarray(x) for x in geodesic_in_chart(chart, start, velocity))
    manifold = MANIFOLDS[name]
    np.testing.assert_allclose(manifold.exp(p, v), q, atol=1e-10)
    np.testing.assert_allclose(manifold.log(p, q), v, atol=1e-9)
    np.testing.assert_allclose(
        manifold.squared_distance(p, q), jnp.sum(v**2), atol=1e-9
    )


def test_exp_converges_with_order_eight():
    p, v, q = (
        jnp.asarray(x)
        for x in geodesic_in_chart(torus_chart, np.array([0.7, 0.4]), np.array([2, 1]))
    )
    coarse, fine = (
        jnp.linalg.norm(geodesic_exp(MANIFOLDS["torus"], p, v, steps=steps) - q)
        for steps in (8, 16)
    )
    assert 150 < coarse / fine < 700


@pytest.mark.parametrize("name", ["torus", "ellipsoid"])
def test_log_finds_short_geodesics_also_far_away(name, key):
    """On random pairs, many of them beyond the injectivity radius, every geodesic ends
    at q and is as short as the one found from the other end."""
    manifold = MANIFOLDS[name]
    p, q = (manifold.random_points(k, 50) for k in jax.random.split(key))
    v, w = manifold.log(jnp.stack([p, q]), jnp.stack([q, p]))
    np.testing.assert_allclose(manifold.exp(p, v), q, atol=1e-12)
    length = jnp.linalg.norm(v, axis=-1)
    assert jnp.max(length) > manifold.injectivity_radius
    np.testing.assert_allclose(length, jnp.linalg.norm(w, axis=-1), atol=1e-5)


@pytest.mark.slow
def test_three_derivatives_of_the_logarithm():
    """At coincidence, and apart."""
    torus = Torus(2.0, 0.8)
    p = jnp.array([2.8, 0.0, 0.0])
    q = torus.exp(p, jnp.array([[0.0, 0.0, 0.0], [0.0, 0.8, 0.6]]))
    line = lambda t: torus.log(
        p + t * jnp.array([0.1, 0.2, 0.3]), q + t * jnp.array([0.2, -0.3, 0.1])
    )
    np.testing.assert_allclose(derivatives(line), differences(line), atol=1e-6)


def test_distance_and_projection_differentiate_in_the_shape():
    p, q = (jnp.asarray(torus_chart(u)[0]) for u in ([0.3, 0.2], [1.0, 0.9]))

    def by_radius(t):
        torus = Torus(2.0 + t, 0.8)
        return torus.squared_distance(torus.project(p), torus.project(q))[None]

    def by_axes(t):
        return Ellipsoid(jnp.asarray(AXES) + t * jnp.array([1.0, -0.5, 0.3])).project(
            jnp.array([0.9, 1.1, 1.2])
        )

    for function, orders in ((by_radius, 1), (by_axes, 2)):
        np.testing.assert_allclose(
            derivatives(function, orders), differences(function, orders), atol=1e-6
        )


@pytest.mark.parametrize("scale", [0.4, 0.8, 1.3, 3.0])
def test_closest_point_of_the_ellipsoid_against_scipy(scale):
    p = scale * ellipsoid_chart([1.2, 0.5])[0] + np.array([0.02, -0.05, 0.1])
    distance = lambda u: np.sum((ellipsoid_chart(u)[0] - p) ** 2)
    starts = [[t, f] for t in (0.5, 1.5, 2.5) for f in range(0, 6, 2)]
    runs = [scipy.optimize.minimize(distance, s, tol=1e-14) for s in starts]
    best = min(runs, key=lambda run: run.fun)
    found = Ellipsoid(AXES).project(jnp.asarray(p))
    np.testing.assert_allclose(found, ellipsoid_chart(best.x)[0], atol=1e-6)
    np.testing.assert_allclose(np.sum((found / AXES) ** 2), 1.0, atol=1e-14)


@pytest.mark.slow
def test_level_set_agrees_with_closed_formulas(key):
    def torus_equation(p):
        return (jnp.linalg.norm(p[:2]) - 2.0) ** 2 + p[2] ** 2 - 0.64

    torus = MANIFOLDS["torus"]
    level_set = LevelSet(torus_equation, 3, scale=2.0)
    p = torus.random_points(key, 10)
    x = p + 0.3 * jax.random.normal(jax.random.key(1), p.shape)
    u, v = torus.tangent_projection(p, jax.random.normal(key, (2, *p.shape)) / 2)
    np.testing.assert_allclose(level_set.project(x), torus.project(x), atol=1e-13)
    for method, arguments in [
        ("tangent_projection", (x, u)),
        ("second_fundamental_form", (p, u, v)),
        ("exp", (p, u)),
    ]:
        found = getattr(level_set, method)(*arguments)
        expected = getattr(torus, method)(*arguments)
        np.testing.assert_allclose(found, expected, atol=1e-10)
    assert level_set.dim == 2
    reach = np.asarray(level_set.reach)
    assert 0.8 <= reach < 0.88  # the estimate errs upwards, a little
    assert LevelSet(torus_equation, 3, reach=0.5).reach == 0.5


def test_closest_points_of_a_space_curve_against_scipy():
    curve, p = MANIFOLDS["curve"], np.array([0.9, 0.7, 0.4])
    equations = {"type": "eq", "fun": lambda y: np.asarray(curve.function(y))}
    run = scipy.optimize.minimize(
        lambda y: np.sum((y - p) ** 2), p, constraints=equations, tol=1e-15
    )
    assert curve.dim == 1
    np.testing.assert_allclose(curve.project(jnp.asarray(p)), run.x, atol=1e-6)


class Ball(eqx.Module):
    radius: jax.Array

    def __call__(self, p):
        return jnp.sum(p**2) - self.radius**2


def test_level_set_differentiates_in_the_parameters_of_its_function():
    p = jnp.array([1.0, 2.0, 2.0])
    project = lambda radius: LevelSet(Ball(radius), 3).project(p)
    slope = jax.jacfwd(project)(jnp.array(1.5))
    np.testing.assert_allclose(slope, p / 3.0, atol=1e-14)


class Paraboloid(AbstractManifold):
    """z = (a x^2 + b y^2)/2, as a user might write it."""

    curvatures: jax.Array
    dim: int = eqx.field(static=True, default=2)

    @property
    def point_shape(self):
        return (3,)

    @property
    def reach(self):
        return 1.0 / jnp.max(self.curvatures)

    @property
    def injectivity_radius(self):
        return np.pi * self.reach

    def closest_point(self, p):
        def step(_, t):  # x = p_x/(1 + t a), y = p_y/(1 + t b), z = p_z + t
            plane = p[:2] / (1 + t * self.curvatures)
            value = p[2] + t - self.curvatures @ plane**2 / 2
            return t - value / (1 + self.curvatures**2 @ (plane**2 / (p[:2] / plane)))

        t = jax.lax.fori_loop(0, 60, step, jnp.zeros(()))
        return jnp.append(p[:2] / (1 + t * self.curvatures), p[2] + t)

    def normal(self, y):
        slope = self.curvatures * y[..., :2]
        normal = jnp.concatenate([-slope, jnp.ones_like(y[..., 2:])], axis=-1)
        return normal / jnp.linalg.norm(normal, axis=-1, keepdims=True)

    def tangent_at(self, y, v):
        normal = self.normal(y)
        return v - jnp.sum(normal * v, axis=-1, keepdims=True) * normal

    def project(self, p):
        return implicit_projection(
            self,
            p,
            closest_point=Paraboloid.closest_point,
            tangent_projection=Paraboloid.tangent_at,
            second_fundamental_form=Paraboloid.second_fundamental_form,
        )

    def tangent_projection(self, p, v):
        return self.tangent_at(self.project(p), v)

    def second_fundamental_form(self, p, u, v):
        normal = self.normal(p)
        bend = jnp.sum(self.curvatures * (u * v)[..., :2], axis=-1, keepdims=True)
        return bend * normal[..., 2:] * normal

    def squared_distance(self, p, q):
        return jnp.sum(self.log(p, q) ** 2, axis=-1)

    def exp(self, p, v):
        return geodesic_exp(self, p, v)

    def log(self, p, q):
        return shooting_log(self, p, q)

    def random_points(self, key, n):
        plane = jax.random.normal(key, (n, 2))
        height = plane**2 @ self.curvatures / 2
        return jnp.concatenate([plane, height[:, None]], axis=1)


@pytest.mark.slow
def test_laws_of_a_manifold_of_the_user(key):
    paraboloid = Paraboloid(jnp.array([1.0, 0.5]))
    check_manifold(paraboloid, paraboloid.random_points(key, 4))


def test_implicit_projection_in_a_manifold_of_the_user():
    paraboloid = Paraboloid(jnp.array([1.0, 0.5]))
    equation = lambda p: p[2] - (p[0] ** 2 + p[1] ** 2 / 2) / 2
    p, u = jnp.array([0.4, -0.5, 0.6]), jnp.array([0.5, 0.2, -0.1])
    line = lambda t: paraboloid.project(p + t * u)
    level_set = LevelSet(equation, 3, reach=1.0)
    np.testing.assert_allclose(line(0.0), level_set.project(p), atol=1e-14)
    np.testing.assert_allclose(derivatives(line), differences(line), atol=1e-7)
    with pytest.raises(NotImplementedError, match="implicit_solution"):
        jax.jacfwd(lambda c: Paraboloid(c).project(p))(jnp.array([1.0, 0.5]))


def test_second_form_from_the_projection_alone(key):
    for name in ("torus", "flat_torus"):
        manifold = MANIFOLDS[name]
        p = manifold.random_points(key, 3)
        noise = jax.random.normal(key, (2, *p.shape))
        u, v = manifold.tangent_projection(p, noise)
        np.testing.assert_allclose(
            second_form_of_projection(manifold.project, p, u, v),
            manifold.second_fundamental_form(p, u, v),
            atol=1e-12,
        )


def test_flat_torus_and_cylinder_are_flat():
    """Their distances are those of the angles and heights."""
    angles = np.array([[0.1, 3.0], [1.9, -2.5]])
    radii = np.array([1.0, 2.0])
    on_circles = lambda a: jnp.asarray(
        (radii[:, None] * np.stack([np.cos(a), np.sin(a)], 1)).ravel()
    )
    p, q = on_circles(angles[0]), on_circles(angles[1])
    gap = radii * np.array([1.8, 2 * np.pi - 5.5])
    torus = FlatTorus(2, jnp.asarray(radii))
    np.testing.assert_allclose(torus.squared_distance(p, q), gap @ gap, atol=1e-13)
    np.testing.assert_allclose(jnp.linalg.norm(torus.log(p, q)), np.sqrt(gap @ gap))
    a, b = jnp.array([2.0, 0.0, 1.0]), jnp.array([0.0, -2.0, 5.0])
    np.testing.assert_allclose(Cylinder(2.0).squared_distance(a, b), np.pi**2 + 16)
    v = jnp.array([0.0, -np.pi, 4.0])
    np.testing.assert_allclose(Cylinder(2.0).log(a, b), v, atol=1e-14)


def test_product_splits_and_joins(key):
    product = Product(Sphere(2), MANIFOLDS["so3"], Euclidean(1))
    p = product.random_points(key, 4)
    sphere, rotation, number = product.split(p)
    assert p.shape == (4, 13) and product.dim == 6
    assert rotation.shape == (4, 3, 3) and number.shape == (4, 1)
    np.testing.assert_array_equal(product.join(sphere, rotation, number), p)
    np.testing.assert_allclose(
        product.squared_distance(p[0], p[1]),
        Sphere(2).squared_distance(*sphere[:2])
        + MANIFOLDS["so3"].squared_distance(*rotation[:2])
        + (number[0, 0] - number[1, 0]) ** 2,
    )
    with pytest.raises(ValueError, match="3 parts"):
        product.join(sphere, rotation)


def test_random_points_of_the_torus_are_uniform(key):
    p = Torus(2.0, 1.5).random_points(key, 20_000)
    cosine = (jnp.linalg.norm(p[:, :2], axis=1) - 2.0) / 1.5
    moments = [jnp.mean(cosine), jnp.mean(cosine**2)]
    np.testing.assert_allclose(moments, [1.5 / 4.0, 0.5], atol=0.02)


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Torus(1.0, 2.0), "smaller than `R`"),
        (lambda: Cylinder(-1.0), "`radius` must be positive"),
        (lambda: Cylinder(jnp.array(-1.0)), "`radius` must be positive"),
        (lambda: Sphere(2, jnp.array(0.0)), "`radius` must be positive"),
        (lambda: Torus(jnp.array(1.0), jnp.array(2.0)), "`r` must be positive"),
        (lambda: FlatTorus(2, jnp.array([1.0, -1.0])), "`radii` must be positive"),
        (lambda: FlatTorus(0), "`dim` must be at least 1"),
        (lambda: FlatTorus(2, jnp.ones(3)), "`radii` must be a scalar or of shape"),
        (lambda: FlatTorus(2, -1.0), "`radii` must be positive"),
        (lambda: Ellipsoid([1.0, -1.0]), "`axes` must be positive"),
        (lambda: Ellipsoid([1.0]), "at least 2 semi-axes"),
        (lambda: Product(), "at least one factor"),
        (lambda: LevelSet(lambda p: p, 3), "no manifold of positive dimension"),
        (lambda: LevelSet(lambda p: p[None], 3), "a result of shape"),
    ],
)
def test_wrong_arguments(make, message):
    with pytest.raises(ValueError, match=message):
        make()


class FlawedSphere(AbstractManifold):
    """The unit sphere in R^3, but for the method that `flaw` names."""

    flaw: str = eqx.field(static=True)
    dim: int = eqx.field(static=True, default=2)

    @property
    def point_shape(self):
        return (3,)

    @property
    def reach(self):
        return {"reach": 1.5, "no reach": -1.0}.get(self.flaw, 1.0)

    @property
    def injectivity_radius(self):
        return 7 * np.pi if self.flaw == "injectivity" else np.pi

    def project(self, p):
        closest = Sphere(2).project(p)
        if self.flaw == "half way":
            return (p + closest) / 2
        if self.flaw == "askew":  # derivative right on the sphere, closest point wrong
            off = jnp.sum(p**2, -1, keepdims=True) - 1
            return Sphere(2).project(p + off**2 * jnp.array([0.3, 0.0, 0.0]))
        if self.flaw == "frozen":
            return jax.lax.stop_gradient(closest)
        if self.flaw == "float32":
            return closest.astype(jnp.float32)
        return closest

    def tangent_projection(self, p, v):
        if self.flaw == "full rank":
            return v + 0 * p
        if self.flaw == "doubled":
            return 2 * Sphere(2).tangent_projection(p, v)
        if self.flaw == "fixed plane":
            return v * jnp.array([1.0, 1.0, 0.0]) + 0 * p
        if self.flaw == "only on the sphere":
            return v - jnp.sum(p * v, axis=-1, keepdims=True) * p
        return Sphere(2).tangent_projection(p, v)

    def second_fundamental_form(self, p, u, v):
        sign = -1 if self.flaw == "sign" else 1
        return sign * Sphere(2).second_fundamental_form(p, u, v)

    def squared_distance(self, p, q):
        if self.flaw == "arccos":
            return jnp.arccos(jnp.clip(jnp.sum(p * q, axis=-1), -1, 1)) ** 2
        if self.flaw == "distance":
            return jnp.sqrt(Sphere(2).squared_distance(p, q))
        if self.flaw == "batch":
            return jnp.sum((p - q) ** 2)
        if self.flaw == "chord":
            return jnp.sum((p - q) ** 2, axis=-1)
        factor = 2.0 if self.flaw == "factor" else 1.0
        return factor * Sphere(2).squared_distance(p, q)

    def exp(self, p, v):
        if self.flaw == "straight":
            return p + v
        if self.flaw == "retraction":
            return self.project(p + v)
        if self.flaw == "bent":  # starts right, at the right speed
            turn = jnp.sum(v**2, -1, keepdims=True) ** 2 * jnp.cross(p, v)
            return Sphere(2).exp(p, v + turn)
        return Sphere(2).exp(p, v)

    def log(self, p, q):
        if self.flaw == "clipped":  # theta / sin(theta), constant close to the antipode
            cosine = jnp.sum(p * q, axis=-1, keepdims=True)
            angle = jnp.arccos(jnp.clip(cosine, -np.cos(0.5), 1 - 1e-15))
            return angle / jnp.sin(angle) * Sphere(2).tangent_projection(p, q)
        return -Sphere(2).log(p, q) if self.flaw == "log" else Sphere(2).log(p, q)

    def random_points(self, key, n):
        if self.flaw == "same":
            return Sphere(2).random_points(key, 1) * jnp.ones((n, 1))
        return Sphere(2).random_points(key, n)


FLAWS = {
    "half way": r"`FlawedSphere.project` breaks[\s\S]* project\(project\(x\)\)",
    "fixed plane": r"tangent_projection` breaks[\s\S]* D project\(p\)\[w\]",
    "sign": r"second_fundamental_form` breaks[\s\S]*\nby 1\.\d+[\s\S]*Check its sign",
    "straight": r"exp` breaks[\s\S]*end points leave the manifold",
    "factor": r"squared_distance` breaks[\s\S]* = \|v\|\^2",
    "arccos": r"squared_distance` breaks[\s\S]*not finite[\s\S]*arccos",
    "float32": r"project` must return float64",
    "batch": r"squared_distance` must return float64 of shape \(2, 3\)",
    "clipped": r"log` breaks[\s\S]*\nby 1\.\d+",
    "no reach": r"`FlawedSphere.reach` must be positive, found -1",
}
MORE_FLAWS = {
    "full rank": r"tangent_projection` breaks[\s\S]* rank dim\nby 1,",
    "reach": r"project` breaks[\s\S]*`reach` is too large",
    "askew": r"project` breaks[\s\S]* x - project\(x\) is normal",
    "frozen": r"derivative rule of `project` is wrong",
    "doubled": r"tangent_projection` breaks[\s\S]* symmetric and idempotent",
    "only on the sphere": r"Off the manifold it must project",
    "retraction": r"exp` breaks[\s\S]* keeps its speed",
    "bent": r"exp` breaks",
    "log": r"log` breaks[\s\S]* log\(p, exp\(p, v\)\) = v",
    "injectivity": r"log` breaks[\s\S]*`injectivity_radius` is too large",
    "chord": r"squared_distance` breaks[\s\S]* = \|v\|\^2",
    "distance": r"squared_distance` breaks[\s\S]* = \|v\|\^2",
    "same": r"random_points` breaks",
}


@pytest.mark.parametrize(
    "flaw, message",
    list(FLAWS.items())
    + [pytest.param(*flaw, marks=pytest.mark.slow) for flaw in MORE_FLAWS.items()],
)
def test_check_manifold_names_the_flaw(flaw, message, key):
    points = Sphere(2).random_points(key, 4)
    with pytest.raises(ValueError, match=message):
        check_manifold(FlawedSphere(flaw), points)


def test_check_manifold_reports_every_law(key):
    """On a manifold of the user, without a flaw."""
    report = check_manifold(FlawedSphere("none"), Sphere(2).random_points(key, 4))
    assert len(report) == 23 and 0.0 < max(report.values()) < 1e-8


def test_check_manifold_on_wrong_points(key):
    sphere = Sphere(2)
    with pytest.raises(ValueError, match="at point 1:[\\s\\S]*else check `points`"):
        check_manifold(sphere, jnp.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.1]]))
    with pytest.raises(ValueError, match="must have shape"):
        check_manifold(sphere, jnp.ones((3, 2)))
    points = sphere.random_points(key, 2)
    with pytest.raises(ValueError, match="`log_up_to` must lie between 0 and 1"):
        check_manifold(sphere, points, log_up_to=1.0)
    with jax.enable_x64(False), pytest.raises(ValueError, match="jax_enable_x64"):
        check_manifold(sphere, points)


def test_level_sets_find_the_reach_of_the_sphere():
    sphere = LevelSet(lambda p: p @ p - 1.0, 3)
    np.testing.assert_allclose(sphere.reach, 1.0, atol=1e-9)
    np.testing.assert_allclose(sphere.injectivity_radius, np.pi, atol=1e-9)


def moved(psi, s):
    """Derivatives of the polynomial curve with derivatives `psi` at 0, at s."""
    p = len(psi)
    return [
        sum(psi[k + i] * s**i / math.factorial(i) for i in range(p - k))
        for k in range(p)
    ]


QUICK = ["sphere", "sphere3", "euclidean", "flat_torus", "spd"]
ISOMETRIC = [name for name in MANIFOLDS if MANIFOLDS[name].isometric]


@pytest.mark.parametrize(
    "name",
    [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in ISOMETRIC],
)
def test_covariant_derivatives(name, key):
    """Each order is the derivative of the one before, projected. (Those of other metrics
    have a law of their own.)"""
    manifold, h = MANIFOLDS[name], 1e-4
    size = min(float(manifold.reach), 1.0)
    p = manifold.random_points(key, 1)[0]
    bend = jax.random.normal(jax.random.fold_in(key, 1), (4, *p.shape))
    psi = [p + 0.05 * size * bend[0], *(0.5 * size * bend[1:])]
    for order in (2, 3):
        lower = lambda s, order=order: manifold.covariant_derivative(
            moved(psi, s)[:order]
        )
        change = (lower(h) - lower(-h)) / (2 * h)
        expected = manifold.tangent_projection(manifold.project(psi[0]), change)
        found = manifold.covariant_derivative(psi[: order + 1])
        scale = jnp.linalg.norm(expected) + size
        assert jnp.linalg.norm(found - expected) < 1e-5 * scale


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_series_of_the_sphere(order, key):
    """Against automatic differentiation."""
    sphere = Sphere(3, 1.7)
    psi = list(jax.random.normal(key, (order + 1, 4)))
    found = sphere.covariant_derivative(psi)
    expected = covariant_derivative(sphere, psi)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
