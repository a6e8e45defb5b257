"""Every manifold as a target of a curve, and as a source."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from curves import TIMES, X, curve_problem
from helpers import MANIFOLDS
from scipy.integrate import dblquad

import manireg as mr
from manireg._discretisation.domain import discretise
from manireg._solver.evaluation import evaluate
from manireg._solver.linear import direct_solvers
from manireg._solver.starts import free_solution

pytestmark = pytest.mark.slow  # minutes of compilation


@pytest.mark.parametrize("name", MANIFOLDS)
def test_data_on_a_geodesic_are_followed_without_energy(name):
    target = MANIFOLDS[name]
    p = target.random_points(jax.random.key(1), 1)[0]
    v = jax.random.normal(jax.random.key(2), target.point_shape)
    v = target.tangent_projection(p, v)
    # coordinates of geodesics of another metric grow like exponentials
    longest = 2.0 if target.isometric else 0.5
    size = min(longest, 0.6 * float(target.injectivity_radius))
    v = v * size / jnp.linalg.norm(target.orthonormal(p, v))
    geodesic = jax.vmap(lambda t: target.exp(p, t * v))
    model = mr.solve(curve_problem(target, geodesic(jnp.asarray(X))), 0.1)
    assert model.energies.eells < 1e-8 * size**2
    expected = geodesic(jnp.asarray(TIMES))
    np.testing.assert_allclose(model(TIMES), expected, atol=1e-5 * size)


def ellipsoid_area(a, b, c):
    def element(u, v):
        s = np.sin(v) ** 2 * ((b * np.cos(u)) ** 2 + (a * np.sin(u)) ** 2)
        return np.sin(v) * np.sqrt(s * c**2 + (a * b * np.cos(v)) ** 2)

    return dblquad(element, 0, np.pi, 0, 2 * np.pi)[0]


CIRCLE_AND_LINE = mr.Product(mr.Sphere(1), mr.Euclidean(1))
HEIGHTS = jnp.stack([jnp.cos(X), jnp.sin(X), 3 * jnp.asarray(X)], axis=1)
SOURCES = {
    "interval": (mr.Interval(-1, 2), 3, 1e-12),
    "box": (mr.Box([0, 1], [2, 4]), 6, 1e-12),
    "cuboid": (mr.Box([0, 0, 0], [1, 2, 3]), 6, 1e-12),
    "circle": (mr.Sphere(1, 2.0), 4 * np.pi, 1e-12),
    "sphere": (mr.Sphere(2, 2.0), 16 * np.pi, 1e-12),
    "sphere3": (mr.Sphere(3, 0.5), np.pi**2 / 4, 2e-2),
    "flat_torus": (MANIFOLDS["flat_torus"], 8 * np.pi**2, 1e-12),
    "torus": (mr.Torus(2.0, 0.8), 4 * np.pi**2 * 1.6, 1e-12),
    "cylinder": (mr.Cylinder(), 2 * np.pi * 3 * (X[-1] - X[0]), 1e-12),
    "product": (CIRCLE_AND_LINE, 2 * np.pi * 3 * (X[-1] - X[0]), 1e-12),
    "ellipsoid": (MANIFOLDS["ellipsoid"], ellipsoid_area(1.0, 1.5, 2.0), 5e-3),
    "so3": (MANIFOLDS["so3"], 16 * np.sqrt(2) * np.pi**2, 2e-2),
}  # fmt: skip


def around(name):
    return HEIGHTS if name in ("cylinder", "product") else None


@pytest.mark.parametrize("name", SOURCES)
def test_domains_integrate_and_carry_orthonormal_frames(name):
    source, volume, accuracy = SOURCES[name]
    domain = discretise(source, 60, around(name))
    assert float(jnp.sum(domain.weights)) == pytest.approx(volume, rel=accuracy)
    assert np.all(domain.weights > 0)
    gram = jnp.einsum("qsa,qsb->qab", domain.frames, domain.frames)
    identity = np.broadcast_to(np.eye(source.dim), gram.shape)
    np.testing.assert_allclose(gram, identity, atol=1e-10)
    mixed = jnp.einsum("qabs,qsc->qabc", domain.second_forms, domain.frames)
    np.testing.assert_allclose(mixed, 0, atol=1e-8)
    if isinstance(source, mr.AbstractManifold) and around(name) is None:
        centroid = domain.weights @ domain.points / volume
        size = float(jnp.max(jnp.abs(domain.points)))
        np.testing.assert_allclose(centroid, 0, atol=5e-3 * size)


@pytest.mark.parametrize("name", SOURCES)
def test_ambient_linear_functions_are_reproduced(name):
    """By the free start on any source, whatever lambda; then by evaluation elsewhere."""
    source = SOURCES[name][0]
    limits = around(name)
    points = discretise(source, 40, limits).points
    new, x = points[3::11], points[::3]
    if limits is not None:
        x = jnp.concatenate([x, limits])
    slope = jnp.cos(jnp.arange(2.0 * x.shape[1]) + 1).reshape(x.shape[1], 2)
    problem = mr.make_problem(
        source, mr.Euclidean(2), x.reshape(-1, *source.point_shape), x @ slope + 1.0,
        centres=40,
    )  # fmt: skip
    w = eqx.filter_jit(free_solution)(problem, 1e-2, direct_solvers(problem))
    values, covered = evaluate(problem.basis, w, new, problem.origin)
    assert covered
    np.testing.assert_allclose(values, new @ slope + 1.0, atol=1e-6)


@pytest.mark.parametrize("name", ["circle", "torus"])
def test_identity_is_found(name):
    """An isometry: no energy, whatever lambda."""
    source = SOURCES[name][0]
    x = source.random_points(jax.random.key(0), 40)
    model = mr.fit(source, source, x, x, 1.0, centres=60)
    assert model.energies.eells < 1e-8
    new = source.random_points(jax.random.key(1), 30)
    np.testing.assert_allclose(model(new), new, atol=1e-6)
