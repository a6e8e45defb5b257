"""Energies known exactly, of callables and through the basis."""

# pyright: reportArgumentType=false, reportIndexIssue=false

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

import manireg as mr
from manireg._objective.objective import objective
from manireg._objective.sites import Stage
from manireg._solver.linear import direct_solvers
from manireg._solver.starts import free_solution

UNIT = mr.Interval(0, 1)
SPHERE = mr.Sphere(2)
ROTATIONS = mr.manifolds.SpecialOrthogonal(3)
SPIN = jnp.array([[0.0, -0.3, 0.5], [0.3, 0.0, -0.7], [-0.5, 0.7, 0.0]])
TURN = jnp.asarray(Rotation.from_rotvec([0.4, -1.1, 0.8]).as_matrix())
exact = lambda value: pytest.approx(value, rel=1e-6)
zero = pytest.approx(0, abs=1e-16)


def disk(radius=1.0, order=24):
    """The disk in the plane: Gauss rule in r, trapezoid rule in the angle."""
    r, w = np.polynomial.legendre.leggauss(order)
    r, w = radius * (1 + r) / 2, radius * w / 2
    angle = 2 * np.pi * np.arange(2 * order) / (2 * order)
    points = np.stack([np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle))], -1)
    Q = points.size // 2
    return mr.Domain(
        jnp.asarray(points.reshape(Q, 2)),
        jnp.broadcast_to(jnp.eye(2), (Q, 2, 2)),
        jnp.zeros((Q, 2, 2, 2)),
        jnp.asarray(np.outer(w * r, np.full(2 * order, np.pi / order)).ravel()),
    )


def great_circle(t):
    return jnp.stack([jnp.cos(t), 0.6 * jnp.sin(t), 0.8 * jnp.sin(t)])


def lon_lat(lon, lat):
    xy = jnp.cos(lat) * jnp.stack([jnp.cos(lon), jnp.sin(lon)])
    return jnp.append(xy, jnp.sin(lat))


def small_circle(colatitude, speed):
    return lambda t: lon_lat(speed * t, jnp.pi / 2 - colatitude)


def moebius(k):
    """The dilation z -> k z of S^2, seen from the north pole."""

    def map(p):
        below, above = 1 - p[2], k**2 * (1 + p[2])
        return jnp.append(2 * k * p[:2], above - below) / (below + above)

    return map


def moebius_factor(k, z):
    return 2 * k / ((1 - z) + k**2 * (1 + z))


def stretch(p):
    """Colatitude th -> th + 0.1 sin(2 th)."""
    sine = jnp.linalg.norm(p[:2])
    theta = jnp.arctan2(sine, p[2])
    rho = theta + 0.1 * jnp.sin(2 * theta)
    return jnp.append(jnp.sin(rho) * p[:2] / sine, jnp.cos(rho))


def rotational_energy(rho, d_rho, dd_rho, f, df, g, dg, upper):
    """mathematics.md 4 d with k = 1, by adaptive quadrature in r."""

    def density(r):
        y, dy = rho(r), d_rho(r)
        meridian = df(r) * dy / f(r) - g(y) * dg(y) / f(r) ** 2
        mixed = dy * dg(y) / f(r) - df(r) * g(y) / f(r) ** 2
        total = dd_rho(r) ** 2 + meridian**2 + 2 * mixed**2
        return 2 * np.pi * f(r) * total

    return quad(density, 1e-6, upper - (1e-6 if upper == np.pi else 0), epsabs=1e-11)[0]


@pytest.mark.parametrize(
    ("map", "energy"),
    [
        (great_circle, zero),
        (lambda t: great_circle(1.3 * t**2), exact(4 * 1.3**2)),
        (lambda t: great_circle(jnp.sin(3 * t)), exact(40.5 - 6.75 * np.sin(6))),
        (small_circle(jnp.pi / 4, 2 * jnp.pi), exact(4 * np.pi**4)),
        (small_circle(0.3, 2.0), exact(16 * np.sin(0.3) ** 2 * np.cos(0.3) ** 2)),
    ],
    ids=["a, geodesic", "a, b t^2", "a, sin 3t", "b, 45 degrees", "b"],
)
def test_curves_on_the_sphere(map, energy):
    assert mr.eells_energy(UNIT, SPHERE, map, 400) == energy


def test_longitude_and_latitude():
    def density(v):
        return np.sin(v) ** 2 * np.cos(v) ** 2 + 2 * np.sin(v) ** 2

    energy = mr.eells_energy(mr.Box([0, -1], [1, 1]), SPHERE, lambda u: lon_lat(*u))
    assert energy == exact(quad(density, -1, 1)[0]) == 1.3880027291


def test_exponential_map_of_the_disk():
    def map(u):
        r = jnp.linalg.norm(u)
        return jnp.append(jnp.sin(r) * u / r, jnp.cos(r))

    one = lambda r: 1.0
    truth = rotational_energy(
        lambda r: r, one, lambda r: 0.0, lambda r: r, one, np.sin, np.cos, 1.0
    )
    energy = mr.eells_energy(mr.Box([-1, -1], [1, 1]), SPHERE, map, disk())
    assert energy == exact(truth) == 0.8420954833


def test_stretched_latitudes():
    truth = rotational_energy(
        lambda r: r + 0.1 * np.sin(2 * r),
        lambda r: 1 + 0.2 * np.cos(2 * r),
        lambda r: -0.4 * np.sin(2 * r),
        np.sin, np.cos, np.sin, np.cos, np.pi,
    )  # fmt: skip
    assert mr.eells_energy(SPHERE, SPHERE, stretch) == exact(truth) == 1.5961501362


def test_inverse_stereographic_projection_of_the_disk():
    def map(u):
        square = u @ u
        return jnp.append(2 * u, square - 1) / (square + 1)

    energy = mr.eells_energy(mr.Box([-1, -1], [1, 1]), SPHERE, map, disk())
    assert energy == exact(16 * np.pi / 3)


@pytest.mark.parametrize("k", [1.5, 2.0, 3.0])
def test_moebius_dilations(k):
    expected = exact(8 * np.pi / 3 * (k - 1 / k) ** 2)
    map = moebius(k)
    assert mr.eells_energy(SPHERE, SPHERE, map) == expected
    moved = lambda p: TURN @ map(TURN.T @ p)
    assert mr.eells_energy(SPHERE, SPHERE, moved) == expected


def test_thin_plate_is_eells_plus_bending():
    """A conformal map with factor s into the unit sphere bends by 2 s^4."""
    bending = 2 * np.pi * quad(lambda z: 2 * moebius_factor(1.5, z) ** 4, -1, 1)[0]
    both = mr.thin_plate_energy(SPHERE, moebius(1.5))
    assert both - mr.eells_energy(SPHERE, SPHERE, moebius(1.5)) == exact(bending)
    speed, colatitude = 2.0, 0.3
    circle = small_circle(colatitude, speed)
    bending = (speed * np.sin(colatitude)) ** 4
    both = mr.thin_plate_energy(UNIT, circle, 400)
    assert both - mr.eells_energy(UNIT, SPHERE, circle, 400) == exact(bending)


def torus_map(matrix, wave=(0.0, 0.0)):
    def map(p):
        angle = jnp.arctan2(p[1::2], p[::2])
        angle = jnp.asarray(matrix, float) @ angle + jnp.array(wave) * jnp.sin(angle)
        return jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=1).ravel()

    return map


roll = lambda u: jnp.array([jnp.cos(u[0]), jnp.sin(u[0]), u[1]])
HELIX = lambda t: jnp.array([1.5 * jnp.cos(3 * t), 1.5 * jnp.sin(3 * t), t])


@pytest.mark.parametrize(
    ("source", "target", "map"),
    [
        (SPHERE, SPHERE, lambda p: TURN @ p),
        (mr.FlatTorus(2), mr.FlatTorus(2), torus_map([[2, 1], [1, 1]])),
        (mr.Box([0, -1], [3, 1]), mr.Cylinder(), roll),
        (UNIT, mr.Cylinder(1.5), HELIX),
        (UNIT, ROTATIONS, lambda t: TURN @ jax.scipy.linalg.expm(t * SPIN)),
        (SPHERE, mr.Sphere(2, 3.0), lambda p: 3 * TURN @ p),
        (mr.Torus(2.0, 0.8), mr.Torus(2.0, 0.8), lambda p: p),
    ],
    ids=["rotation", "integers", "roll", "helix", "group", "homothety", "identity"],
)
def test_totally_geodesic_maps_cost_nothing(source, target, map):
    assert mr.eells_energy(source, target, map, 1000) == zero


def test_accelerated_rotation():
    map = lambda t: TURN @ jax.scipy.linalg.expm(t**2 * SPIN)
    energy = mr.eells_energy(UNIT, ROTATIONS, map, 200)
    assert energy == exact(4 * float(jnp.sum(SPIN**2)))
    turned = lambda t: map(t) @ TURN
    assert mr.eells_energy(UNIT, ROTATIONS, turned, 200) == exact(float(energy))


def test_wave_on_the_flat_torus():
    torus = mr.FlatTorus(2)
    map = torus_map(np.eye(2), (0.3, 0.0))
    assert mr.eells_energy(torus, torus, map) == exact(2 * np.pi**2 * 0.3**2)


@pytest.mark.parametrize("radius", [0.5, 1.0, 3.0])
def test_inclusion_of_the_sphere(radius):
    sphere, include = mr.Sphere(2, radius), lambda p: p
    assert mr.eells_energy(sphere, mr.Euclidean(3), include) == exact(8 * np.pi)
    assert mr.thin_plate_energy(sphere, include) == exact(8 * np.pi)
    assert mr.eells_energy(sphere, sphere, include) == pytest.approx(0, abs=1e-20)


def test_inclusion_of_the_torus():
    """int of the squared principal curvatures, 1/r and cos v / (R + r cos v)."""
    R, r = 2.0, 0.8
    rho = lambda v: R + r * np.cos(v)
    density = lambda v: (1 / r**2 + (np.cos(v) / rho(v)) ** 2) * r * rho(v)
    truth = 2 * np.pi * quad(density, 0, 2 * np.pi)[0]
    energy = mr.eells_energy(mr.Torus(R, r), mr.Euclidean(3), lambda p: p)
    assert energy == exact(truth)


def legendre(degree):
    c = np.polynomial.legendre.leg2poly(np.eye(degree + 1)[degree])
    return lambda z: sum(c * z**i for i, c in enumerate(c))


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("radius", [1.0, 2.0])
def test_spherical_harmonics(degree, radius):
    """L (L - 1) |f|^2 / r^4 with L = l (l + 1); |P_l|^2 = 4 pi r^2 / (2 l + 1)."""
    map = lambda p: jnp.stack([legendre(degree)((TURN @ p)[2] / radius)])
    L = degree * (degree + 1)
    expected = L * (L - 1) * 4 * np.pi / (2 * degree + 1) / radius**2
    energy = mr.eells_energy(mr.Sphere(2, radius), mr.Euclidean(1), map)
    assert energy == exact(expected)


def test_harmonic_on_the_three_sphere():
    """f = x0 x1: L = 8, L (L - 2) = 48, |f|^2 = 2 pi^2 / 24."""
    map = lambda p: (p[0] * p[1])[None]
    energy = mr.eells_energy(mr.Sphere(3), mr.Euclidean(1), map)
    assert energy == exact(48 * 2 * np.pi**2 / 24)


def test_functions_on_flat_sources():
    line = mr.Euclidean(1)
    wave = lambda p: ((p[0] ** 2 - p[1] ** 2) * p[2] - 2 * p[0] * p[1] * p[3])[None]
    energy = mr.eells_energy(mr.FlatTorus(2), line, wave)  # cos(2 th1 + th2)
    assert energy == exact(5**2 * 2 * np.pi**2)
    quadratic = lambda u: (2 * u[0] ** 2 - u[0] * u[1] + 3 * u[1] ** 2)[None]
    energy = mr.eells_energy(mr.Box([0, 0], [2, 3]), line, quadratic)
    assert energy == exact((4 * 4 + 2 * 1 + 4 * 9) * 6)
    cubic = lambda u: (u[0] ** 3)[None]
    assert mr.eells_energy(mr.Box([0, 0], [1, 1]), line, cubic) == exact(12)


@eqx.filter_jit
def energy_through_the_basis(problem):
    """Of the map that follows dense exact data, as the objective sees it."""
    w = free_solution(problem, 1e-15, direct_solvers(problem, "sparse"))
    return objective(w, Stage(problem, 1.0, 0.0, problem.energy))[1].eells


def observed_orders(source, target, map, points, centres, width, truth):
    """Orders in the spacing of the centres, and the last relative error. Narrow supports
    show the order; the default ones start near 1e-4 already."""
    errors = []
    for count in centres:
        x = points(count)
        y = jax.vmap(map)(jnp.asarray(x))
        problem = mr.make_problem(source, target, x, y, centres=count, width=width)
        errors.append(abs(float(energy_through_the_basis(problem)) / truth - 1))
    spacing = np.array(centres) ** (-1 / source.dim)
    return np.diff(np.log(errors)) / np.diff(np.log(spacing)), errors[-1]


@pytest.mark.slow
def test_energy_of_a_curve_through_the_basis_converges():
    map = small_circle(jnp.pi / 4, 2 * jnp.pi)
    points = lambda count: np.linspace(0, 1, 12 * count)
    centres, truth = [8, 16, 32, 64], 4 * np.pi**4
    orders, error = observed_orders(UNIT, SPHERE, map, points, centres, 1.5, truth)
    assert np.all(orders > 2.4)
    assert error < 1e-5


def fibonacci(n):
    i = np.arange(n) + 0.5
    z, angle = 1 - 2 * i / n, np.pi * (1 + 5**0.5) * i
    rho = np.sqrt(1 - z**2)
    return np.stack([rho * np.cos(angle), rho * np.sin(angle), z], axis=1)


@pytest.mark.slow
def test_energy_of_a_moebius_map_through_the_basis_converges():
    points = lambda count: fibonacci(16 * count)
    centres, truth = [25, 50, 100, 200], 8 * np.pi / 3 * (1.5 - 1 / 1.5) ** 2
    orders, error = observed_orders(
        SPHERE, SPHERE, moebius(1.5), points, centres, 1.4, truth
    )
    assert np.all(orders > 1.8)
    assert error < 4e-3


@pytest.mark.slow
def test_energy_of_a_moebius_map_through_the_default_basis():
    x = fibonacci(800)
    y = jax.vmap(moebius(1.5))(jnp.asarray(x))
    energy = energy_through_the_basis(mr.make_problem(SPHERE, SPHERE, x, y, centres=50))
    truth = 8 * np.pi / 3 * (1.5 - 1 / 1.5) ** 2
    assert float(energy) == pytest.approx(truth, rel=1e-4)
