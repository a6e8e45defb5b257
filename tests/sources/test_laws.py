"""What holds of every source: coordinates, points of the quadrature, volumes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from clouds import sphere_cloud
from test_own_source import Cone, Unrolled

import manireg as mr
from manireg._discretisation.domain import centres_of, discretise

LINE = np.linspace(-1, 2, 12)
ROUND = np.stack([np.cos(LINE), np.sin(LINE), 2 * LINE], axis=1)
LOGS = np.random.default_rng(0).normal(size=(12, 2, 2))
LOGS = (LOGS + np.swapaxes(LOGS, 1, 2)).reshape(12, 4)
SQRT_2 = np.sqrt(2)
# name: source, data around, volume, its accuracy
SOURCES = {
    "interval": (mr.Interval(-1, 2), None, 3, 1e-12),
    "circle": (mr.Circle(24), None, 24, 1e-12),
    "box": (mr.Box([0, 1], [2, 4]), None, 6, 1e-12),
    "line": (mr.Euclidean(1), LINE[:, None], 3, 1e-12),
    "sphere1": (mr.Sphere(1, 2.0), None, 4 * np.pi, 1e-12),
    "sphere2": (mr.Sphere(2, 2.0), None, 16 * np.pi, 1e-12),
    "flat_torus": (mr.FlatTorus(2, jnp.array([1.0, 2.0])), None, 8 * np.pi**2, 1e-12),
    "torus": (mr.Torus(2.0, 0.8), None, 4 * np.pi**2 * 1.6, 1e-12),
    "cylinder": (mr.Cylinder(), ROUND, 12 * np.pi, 1e-12),
    "product": (mr.Product(mr.Sphere(1), mr.Euclidean(1)), ROUND, 12 * np.pi, 1e-12),
    "ambient": (mr.Ambient(mr.Torus(2.0, 0.8)), None, 4 * np.pi**2 * 1.6, 1e-12),
    "cloud": (sphere_cloud(400), None, 4 * np.pi, 2e-2),
    "cone": (Cone(), None, 3 * np.pi * SQRT_2, 1e-12),
    "unrolled": (Unrolled(), None, 3 * np.pi * SQRT_2, 1e-12),
}
spd = mr.SymmetricPositiveDefinite(2)
SOURCES["spd"] = (spd, LOGS, None, 0)


@pytest.mark.parametrize("name", SOURCES)
def test_points_lie_on_the_source(name):
    source, around, volume, accuracy = SOURCES[name]
    domain = discretise(source, 40, around)
    if volume is not None:
        found = float(jnp.sum(domain.weights))
        assert found == pytest.approx(volume, rel=accuracy)
    for points in (domain.points, centres_of(source, 40, around).points):
        x = np.asarray(source.from_ambient(np.asarray(points)))
        assert x.shape == (len(points), *source.point_shape)
        source.check_points("x", x)
        assert not np.any(source.outside(x))
        size = np.max(np.abs(points))
        np.testing.assert_allclose(source.to_ambient(x), points, atol=1e-12 * size)


@pytest.mark.parametrize("name", SOURCES)
def test_forms_are_normal_and_frames_orthonormal(name):
    source, around, *_ = SOURCES[name]
    domain = discretise(source, 20, around)
    gram = jnp.einsum("qsa,qsb->qab", domain.frames, domain.frames)
    np.testing.assert_allclose(
        gram, np.tile(np.eye(source.dim), (len(gram), 1, 1)), atol=1e-10
    )
    mixed = jnp.einsum("qabs,qsc->qabc", domain.second_forms, domain.frames)
    np.testing.assert_allclose(mixed, 0, atol=1e-8)


CHARTED = [
    name for name, (source, around, *_) in SOURCES.items()
    if isinstance(source, mr.AbstractManifold) and source.chart(around) is not None
]  # fmt: skip


@pytest.mark.parametrize("name", CHARTED)
def test_charts_bend_as_the_manifold_does(name):
    manifold, around, *_ = SOURCES[name]
    domain = discretise(manifold, 12, around)
    shape = manifold.point_shape
    points = domain.points.reshape(-1, *shape)
    for a in range(manifold.dim):
        for b in range(manifold.dim):
            u, v = (domain.frames[:, :, i].reshape(-1, *shape) for i in (a, b))
            form = manifold.second_fundamental_form(points, u, v)
            found = domain.second_forms[:, a, b].reshape(form.shape)
            np.testing.assert_allclose(found, form, atol=1e-12)


@pytest.mark.parametrize("name", SOURCES)
def test_distances_are_zero_to_itself_and_symmetric(name):
    source, around, *_ = SOURCES[name]
    p = discretise(source, 4, around).points[:6]
    squared = np.asarray(source.squared_distances(p, p))
    assert squared.shape == (len(p), len(p))
    np.testing.assert_allclose(squared, squared.T, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(np.diagonal(squared), 0, atol=1e-12)
    chord = np.sum((np.asarray(p)[:, None] - np.asarray(p)) ** 2, axis=-1)
    assert np.all(squared >= chord * (1 - 1e-9) - 1e-12)


def test_columns_are_numbers_on_an_interval():
    x = np.linspace(0, 1, 9)
    y = np.stack([np.cos(x), np.sin(x)], axis=1)
    interval = mr.Interval(0, 1)
    model = mr.fit(interval, mr.Sphere(1), x, y, 1e-3)
    column = mr.fit(interval, mr.Sphere(1), x[:, None], y, 1e-3)
    np.testing.assert_array_equal(column.coefficients, model.coefficients)
    np.testing.assert_array_equal(model(x[:, None]), model(x))
    np.testing.assert_allclose(
        jax.jit(model)(jnp.asarray(x)[:, None]), model(x), atol=1e-13
    )
    assert model(0.5).shape == (2,)
    assert jax.vmap(model)(jnp.asarray(x)).shape == (9, 2)
