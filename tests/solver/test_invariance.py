"""Units and origins do not matter: the same fit whatever x and y are measured in, and
wherever zero is."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import manireg as mr

K = 14
X = np.sort(np.random.default_rng(0).uniform(size=K)) + 0.02 * np.arange(K)
FINE = np.linspace(X[0], X[-1], 9)
LAM = 1e-3
SCALES = [1e-9, 1e9]
FAR = 1e7  # of the size
EPS = np.finfo(float).eps


def data(target, seed=0):
    """Noisy points along a geodesic."""
    key = jax.random.key(seed)
    start, end = target.random_points(key, 2)
    radius = float(np.minimum(np.asarray(target.injectivity_radius), 1e6))
    v = target.log(start, end)
    size = float(np.sqrt(np.sum(np.asarray(v) ** 2)))
    v = v * min(1.0, 0.5 * radius / size)
    line = jax.vmap(lambda t: target.exp(start, t * v))(jnp.asarray(X))
    noise = jax.random.normal(jax.random.key(1), line.shape)
    spread = 0.05 * float(np.sqrt(np.mean(np.asarray(v) ** 2)))
    return np.asarray(target.project(line + spread * noise))


def fitted(target, x, y, queries, lam):
    """Values of a fit on the line."""
    problem = mr.make_problem(mr.Euclidean(1), target, x[:, None], y, centres=10)
    return np.asarray(mr.solve(problem, lam)(queries[:, None]))


# a target of any size, the directions of a row in which it may be shifted
TARGETS = {
    "Euclidean": (lambda s: mr.Euclidean(2), [1.0, 1.0]),
    "Sphere": (lambda s: mr.Sphere(2, jnp.asarray(s)), None),
    "Circle": (lambda s: mr.Sphere(1, jnp.asarray(s)), None),
    "Cylinder": (lambda s: mr.Cylinder(jnp.asarray(s)), [0.0, 0.0, 1.0]),
    "FlatTorus": (lambda s: mr.FlatTorus(2, jnp.array([s, 2 * s])), None),
    "SPD": (lambda s: mr.SymmetricPositiveDefinite(2), [[1.0, 0.5], [0.5, -2.0]]),
    "Rotations": (lambda s: mr.SpecialOrthogonal(3), None),
    "Poses": (
        lambda s: mr.Product(mr.SpecialOrthogonal(3), mr.Euclidean(3)),
        [0.0] * 9 + [1.0, 2.0, -1.0],
    ),
    "Shapes": (lambda s: mr.PlanarShapes([[0.0, 0.0], [1.0, 0.1], [0.4, 0.9]]), None),
    "Grassmann": (lambda s: mr.Grassmann(3, 1), None),
}
SCALED = ("Euclidean", "Sphere", "Circle", "Cylinder", "FlatTorus", "SPD")
SLOW = {
    "Torus": (lambda s: mr.Torus(jnp.asarray(2 * s), jnp.asarray(s)), None),
    "Ellipsoid": (lambda s: mr.Ellipsoid(s * jnp.array([1.0, 1.5, 2.0])), None),
    "Stiefel": (lambda s: mr.Stiefel(3, 2), None),
}


QUICK = ("Euclidean", "Sphere", "Cylinder", "sphere")


def slow_but(names):
    """The others are slow."""
    mark = lambda name: () if name in QUICK else pytest.mark.slow
    return [pytest.param(name, id=name, marks=mark(name)) for name in names]


@pytest.mark.parametrize("name", slow_but([*TARGETS, *SLOW]))
def test_targets(name):
    build, shift = {**TARGETS, **SLOW}[name]
    target = build(1.0)
    y = data(target)
    size = np.sqrt(np.mean((y - y.mean(axis=0)) ** 2))
    here = fitted(target, X, y, FINE, LAM)

    def same(there, tolerance):
        np.testing.assert_allclose(there, here, rtol=0, atol=tolerance * size)

    for scale in SCALES:  # of x: lambda is a length to the power 4 - m
        there = fitted(target, scale * X, y, scale * FINE, scale**3 * LAM)
        same(there, 1e-8)
    far = FAR * (X[-1] - X[0])
    same(fitted(target, X + far, y, FINE + far, LAM), 100 * EPS * FAR)
    for scale in SCALES if name in (*SCALED, "Torus", "Ellipsoid") else ():
        bigger = scale * y
        there = fitted(build(scale), X, np.asarray(bigger), FINE, LAM)
        same(there / scale, 1e-8)
    if shift is not None:
        away = FAR * size * np.asarray(shift)
        there = fitted(target, X, y + away, FINE, LAM)
        same(there - away, 100 * EPS * FAR * np.abs(shift).max())


# a source of any size, points on it of size one
angles = np.random.default_rng(1).uniform(0, 2 * np.pi, (40, 2))
circle = np.stack([np.cos(angles[:, 0]), np.sin(angles[:, 0])], axis=1)
circles = np.stack([np.cos(angles), np.sin(angles)], axis=2).reshape(40, 4)
SOURCES = {
    "line": (lambda s: mr.Euclidean(1), X[:, None]),
    "plane": (lambda s: mr.Euclidean(2), angles / 6),
    "circle": (lambda s: mr.Sphere(1, jnp.asarray(s)), circle),
    "sphere": (
        lambda s: mr.Sphere(2, jnp.asarray(s)),
        np.asarray(mr.Sphere(2).random_points(jax.random.key(2), 40)),
    ),
    "torus": (lambda s: mr.FlatTorus(2, jnp.asarray(s)), circles),
    "cylinder": (
        lambda s: mr.Cylinder(jnp.asarray(s)),
        np.concatenate([circle, angles[:, 1:] / 3], axis=1),
    ),
}


@pytest.mark.parametrize("name", slow_but(SOURCES))
def test_sources(name):
    build, x = SOURCES[name]
    m = build(1.0).dim
    y = np.sin(3 * x[:, :1]) + x[:, -1:]

    def values(scale, origin=0.0):
        there = scale * x + origin
        problem = mr.make_problem(build(scale), mr.Euclidean(1), there, y, centres=50)
        return np.asarray(mr.solve(problem, LAM * scale ** (4 - m))(there))

    here = values(1.0)
    for scale in SCALES:
        np.testing.assert_allclose(values(scale), here, rtol=0, atol=1e-7)
    if name in ("line", "plane"):
        far = FAR * np.ptp(x)
        np.testing.assert_allclose(values(1.0, far), here, rtol=0, atol=100 * EPS * FAR)


@pytest.mark.slow
@pytest.mark.parametrize("scale", SCALES)
def test_intervals_and_boxes(scale):
    y = np.sin(5 * X)[:, None]
    here = mr.fit(mr.Interval(X[0], X[-1]), mr.Euclidean(1), X, y, LAM)(FINE)
    source = mr.Interval(scale * X[0], scale * X[-1])
    there = mr.fit(source, mr.Euclidean(1), scale * X, y, scale**3 * LAM)
    np.testing.assert_allclose(there(scale * FINE), here, atol=1e-8)
    x, y = angles / 6, np.sin(angles)[:, :1]
    lower, upper = x.min(axis=0), x.max(axis=0)
    box, big = mr.Box(lower, upper), mr.Box(scale * lower, scale * upper)
    here = mr.fit(box, mr.Euclidean(1), x, y, LAM)(x)
    there = mr.fit(big, mr.Euclidean(1), scale * x, y, scale**2 * LAM)(scale * x)
    np.testing.assert_allclose(there, here, atol=1e-8)
