"""A source of a user's own, with a chart."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import manireg as mr
from manireg._discretisation.domain import centres_of, discretise


class Cone(mr.AbstractSource):
    """Of slope 1, between the heights 1 and `top`."""

    top: float = 2.0

    dim = 2
    point_shape = (3,)

    def chart(self, around):
        def embed(u):
            angle, z = u
            return z * jnp.stack([jnp.cos(angle), jnp.sin(angle), 1.0])

        return mr.Chart([0, 1], [2 * jnp.pi, self.top], [True, False], embed)

    def outside(self, x):
        return (x[:, 2] < 1 - 1e-9) | (x[:, 2] > self.top + 1e-9)


class Unrolled(Cone):
    """The same, x its angle (from -pi to pi) and its height."""

    point_shape = (2,)

    def to_ambient(self, x):
        angle, z = x[:, 0], x[:, 1]
        return jnp.stack([z * jnp.cos(angle), z * jnp.sin(angle), z], axis=1)

    def from_ambient(self, p):
        return jnp.stack([jnp.arctan2(p[:, 1], p[:, 0]), p[:, 2]], axis=1)

    def outside(self, x):
        return (x[:, 1] < 1 - 1e-9) | (x[:, 1] > self.top + 1e-9)


def coordinates(k, seed=0):
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(-np.pi, np.pi, k), rng.uniform(1, 2, k)], axis=1)


def flat(x):
    """The cone unrolled to a sector of the plane, an isometry."""
    angle, r = jnp.arctan2(x[..., 1], x[..., 0]), jnp.sqrt(2) * x[..., 2]
    angle = angle / jnp.sqrt(2)
    return r[..., None] * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)


def test_its_area_and_its_curvature():
    domain = discretise(Cone(), 40)
    area = np.pi * np.sqrt(2) * (2**2 - 1)
    assert float(jnp.sum(domain.weights)) == pytest.approx(area, rel=1e-12)
    # the mean curvature of a cone of slope 1 is 1/(2 sqrt 2 z), the Gaussian one 0
    trace = jnp.linalg.norm(jnp.trace(domain.second_forms, axis1=1, axis2=2), axis=1)
    z = domain.points[:, 2]
    np.testing.assert_allclose(trace, 1 / (np.sqrt(2) * z), rtol=1e-10)


def test_straight_lines_of_the_unrolled_cone_cost_nothing():
    energy = mr.eells_energy(Cone(), mr.Euclidean(2), flat, 2000)
    assert energy < 1e-20


def test_a_smooth_function_on_it_is_found():
    cone, plane, shown = Cone(), mr.Euclidean(1), Unrolled()
    x = np.asarray(shown.to_ambient(coordinates(150)))
    height = lambda x: x[:, :1] * x[:, 2:] + x[:, 1:2]
    model = mr.fit(cone, plane, x, height(x), 1e-7, centres=150)
    new = np.asarray(shown.to_ambient(coordinates(50, seed=1)))
    size = np.ptp(height(new))
    np.testing.assert_allclose(model(new), height(new), atol=2e-2 * size)
    own = mr.fit(shown, plane, coordinates(150), height(x), 1e-7, centres=150)
    np.testing.assert_allclose(own(coordinates(50, seed=1)), model(new), atol=1e-8)
    with pytest.raises(ValueError, match="x: 1 of 1 points lie outside Cone"):
        model(3 * new[:1])
    with pytest.raises(Exception, match="x: some points lie outside Cone"):
        jax.block_until_ready(jax.jit(model)(3 * new[0]))


def test_a_chart_has_no_pole():
    class Pole(mr.AbstractSource):
        dim = 2
        point_shape = (3,)

        def chart(self, around):
            embed = lambda u: u[1] * jnp.stack([jnp.cos(u[0]), jnp.sin(u[0]), 0.0])
            return mr.Chart([0, 0], [2 * np.pi, 1], [True, False], embed)

    with pytest.raises(ValueError, match="chart is not of full rank .*a pole"):
        centres_of(Pole(), 30)


def test_without_a_chart():
    class Nowhere(mr.AbstractSource):
        dim = 1
        point_shape = (2,)

        def chart(self, around):
            return None

    with pytest.raises(ValueError, match="Nowhere has neither a chart nor random"):
        discretise(Nowhere(), 30)


@pytest.mark.parametrize(
    ("lower", "upper", "periodic", "message"),
    [
        ([0], [0], [True], "`lower` must be below `upper`"),
        ([0, 1], [1, 2], [True], "must have the same length"),
    ],
)
def test_bad_charts(lower, upper, periodic, message):
    with pytest.raises(ValueError, match=f"Chart: .*{message}"):
        mr.Chart(lower, upper, periodic, lambda u: u)


class Sheet(mr.AbstractSource):
    """A square in space on which the first coordinate counts twice."""

    dim = 2
    point_shape = (3,)

    def chart(self, around):
        embed = lambda u: jnp.stack([u[0], u[1], 0.0])
        metric = lambda u: jnp.diag(jnp.array([4.0, 1.0]))
        return mr.Chart([0, 0], [1, 1], [False, False], embed, metric)


class Twice(mr.Euclidean):
    """The same square, a manifold that fills its space."""

    @property
    def isometric(self):
        return False

    def orthonormal(self, p, v):
        return v * jnp.array([2.0, 1.0])

    def from_orthonormal(self, p, c):
        return c / jnp.array([2.0, 1.0])

    def chart(self, around):
        embed = lambda u: u
        metric = lambda u: jnp.diag(jnp.array([4.0, 1.0]))
        return mr.Chart([0, 0], [1, 1], [False, False], embed, metric)

    @property
    def linear(self):
        return False


@pytest.mark.parametrize("source", [Sheet(), Twice(2)])
def test_frames_in_a_metric_of_its_own(source):
    rng = np.random.default_rng(0)
    u = rng.uniform(size=(40, 2))
    x = np.pad(u, ((0, 0), (0, source.point_shape[0] - 2)))
    model = mr.fit(source, mr.Euclidean(2), x, u, 1e-3)
    stretch = jnp.linalg.svd(model.differential(x).derivatives, compute_uv=False)
    np.testing.assert_allclose(stretch, np.tile([1.0, 0.5], (40, 1)), rtol=1e-6)


class Rope(mr.AbstractSource):
    """A line on which s = u + u^2 / 2 is the length."""

    dim = 1
    point_shape = (2,)

    def chart(self, around):
        embed = lambda u: jnp.stack([u[0], 0.0])
        return mr.Chart([0], [1], [False], embed, lambda u: (1 + u[:, None]) ** 2)


def test_curves_in_a_metric_of_their_own():
    """A map linear in the length has no energy, velocity one, no acceleration."""
    u = np.linspace(0, 1, 30)
    x = np.stack([u, np.zeros(30)], axis=1)
    model = mr.fit(Rope(), mr.Euclidean(1), x, (u + u**2 / 2)[:, None], 1e-3)
    np.testing.assert_allclose(model.velocity(x), 1.0, rtol=1e-5)
    np.testing.assert_allclose(model.acceleration(x), 0.0, atol=1e-3)
    assert model.energies.eells < 1e-8
