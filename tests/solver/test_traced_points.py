"""Traced points of a map are compared with the few centres near them, as others are."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import manireg as mr
from manireg._discretisation.domain import Domain, centres_of
from manireg._discretisation.jets import centres_near
from manireg._discretisation.local_polynomials import (
    LocalPolynomials,
    local_polynomials,
)
from manireg._discretisation.supports import most_supports, supports_at

RNG = np.random.default_rng(0)


def map_on(source, centres: Domain, widths) -> mr.RegressionMap:
    """Some map into the sphere."""
    basis = local_polynomials(centres, widths, 1, centres)
    w = RNG.normal(size=(len(basis.centres) * basis.size, 3))
    none = jnp.zeros(())
    return mr.RegressionMap(
        source, mr.Sphere(2), basis, jnp.array([2.0, 0.0, 0.0]), jnp.asarray(w), none,
        mr.Energies(none, none, none, {}), optx.RESULTS.successful, {},
    )  # fmt: skip


def curve():
    source = mr.Interval(0, 1)
    return map_on(source, centres_of(source, 40), 0.06), np.linspace(0, 1, 300)


def sphere():
    source = mr.Sphere(2)
    x = source.random_points(jax.random.key(0), 300)
    return map_on(source, centres_of(source, 150), 0.6), x


def rotations():
    source = mr.SpecialOrthogonal(3)
    x = source.random_points(jax.random.key(0), 300)
    return map_on(source, centres_of(source, 300), 1.36), x


@pytest.mark.parametrize("made", [curve, sphere, rotations])
def test_they_have_the_same_values(made):
    model, x = made()
    assert most_supports(model.basis) < len(model.basis.centres) / 2
    values = model(x)
    for transform in (jax.jit, jax.vmap):
        np.testing.assert_allclose(transform(model)(x), values, atol=1e-14)
    x = jnp.asarray(x[:20])
    all_centres = jax.jit(lambda model, x: model(x))  # of a basis that is traced, too
    np.testing.assert_allclose(all_centres(model, x), values[:20], atol=1e-14)
    slope = lambda model, x: jax.vmap(jax.grad(lambda x: jnp.sum(model(x) ** 3)))(x)
    assert_close(slope(model, x), jax.jit(slope)(model, x))


@pytest.mark.parametrize("made", [curve, sphere])
def test_they_have_the_same_derivatives(made):
    model, x = made()
    f = model.velocity if model.source.dim == 1 else model.differential
    read = lambda found: getattr(found, "derivatives", found)
    assert_close(read(jax.jit(f)(x)), read(f(x)))
    assert_close(jax.vmap(lambda x: read(f(x)))(x), read(f(x)))


def assert_close(found, truth):
    size = float(jnp.max(jnp.abs(truth)))
    np.testing.assert_allclose(found, truth, atol=1e-12 * size)


def balls(s: int, widest: float, n: int = 120) -> LocalPolynomials:
    """Supports of many sizes, in space of dimension s."""
    shape = n, s
    arrays = RNG.uniform(size=shape), np.zeros((n, s, s)), RNG.uniform(0.05, widest, n)
    arrays = (*arrays, np.zeros((n, 1, 1)))
    return LocalPolynomials(*map(jnp.asarray, arrays), dim=s, degree=0)


@pytest.mark.parametrize("s", [1, 2, 3])
@pytest.mark.parametrize("widest", [0.06, 0.15, 0.4])
def test_there_are_never_more_supports_than_places(s, widest):
    basis = balls(s, widest)
    centres, widths = np.asarray(basis.centres), np.asarray(basis.widths)
    # also where many supports are likely to meet: middles of centres, and the centres
    middles = (centres[:, None] + centres[None])[np.triu_indices(len(centres))] / 2
    x = np.concatenate([RNG.uniform(size=(20_000, s)), middles])
    inside = np.sum((x[:, None] - centres) ** 2, axis=2) < widths**2
    depth, most = np.max(np.sum(inside, axis=1)), most_supports(basis)
    assert depth <= most
    if most < len(centres):
        assert most <= 2.5 * depth  # it is not much more, either
    some = x[np.argsort(-np.sum(inside, axis=1))[:50]]
    found = jax.vmap(lambda x: supports_at(basis, x, most))(some)
    if most < len(centres):
        for row, near in zip(np.asarray(found), centres_near(basis, some), strict=True):
            np.testing.assert_array_equal(row[row >= 0], near[near >= 0])


def test_one_point_of_many_supports_and_none():
    """On a circle around x, all supports meet in x and no more than half elsewhere."""
    angle = 2 * np.pi * np.arange(60) / 60
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    far = np.stack([100 + 10 * np.arange(100), np.zeros(100)], axis=1)
    basis = balls(2, 1.0, 160)
    basis = LocalPolynomials(
        jnp.asarray(np.concatenate([circle, far])), basis.frames,
        jnp.full(160, 1 + 1e-12), basis.mixing, dim=2, degree=0,
    )  # fmt: skip
    most = most_supports(basis)
    assert 60 <= most <= 80
    near = np.asarray(supports_at(basis, jnp.zeros(2), most))
    np.testing.assert_array_equal(near[near >= 0][:60], np.arange(60))
    none = supports_at(basis, jnp.array([0.0, 50.0]), 64)
    np.testing.assert_array_equal(none, -1)
