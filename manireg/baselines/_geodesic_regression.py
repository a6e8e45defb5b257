"""Geodesic regression: the least flexible model, and the limit lambda to infinity."""

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from .._input.numbers import Numbers
from .._input.precision import check_x64
from .._source import AbstractSource
from .._sources.checks import check_source
from .._sources.data import check_data
from ..manifolds import AbstractManifold
from ._inputs import only_for, predicted

LOCAL_STARTS = 6
MAX_STEPS = 500


class GeodesicRegression(eqx.Module):
    r"""$x \mapsto \exp_p(\sum_a (x_a - c_a) V_a)$."""

    source: AbstractSource
    target: AbstractManifold
    centre: Float[Array, " m"]
    """c, the (weighted) mean input."""
    point: Float[Array, "*point_shape"]
    """p, the value there."""
    velocities: Float[Array, "m *point_shape"]
    """V, a tangent vector at p for each input coordinate."""
    loss: Float[Array, ""]
    """(Weighted) mean squared geodesic error on the data."""
    result: optx.RESULTS

    def __call__(self, x: Numbers) -> Float[Array, "..."]:
        """Values at `x`, `(n, *source.point_shape)` or a single point, on the target."""

        def values(flat):
            offset = flat - self.centre
            return _geodesic(self.target, self.point, self.velocities, offset)

        return predicted(self, self.source, self.target, x, values)


def geodesic_regression(
    source: AbstractSource,
    target: AbstractManifold,
    x: Numbers,
    y: Numbers,
    *,
    rank_one: bool = False,
    weights: Numbers | None = None,
) -> GeodesicRegression:
    r"""Minimise $\sum_i w_i d_N(y_i, \exp_p(\sum_a (x_{ia} - c_a) V_a))^2 / \sum_i w_i$
    over points p of N and tangent vectors V_a: in $\mathbb{R}^n$ the least squares line
    or plane. Levenberg-Marquardt in ambient coordinates, from the constant map, from
    the linear regression of log_p y, and from linear regressions of parts of the data
    (so geodesics may wind around N); the lowest loss wins.

    With one input this is Fletcher, Geodesic regression on Riemannian manifolds, 2011,
    and the limit of `manireg.fit` for lambda to infinity. With several it is the model
    of Kim et al., MGLM on Riemannian manifolds, CVPR 2014. Its Eells energy vanishes only
    where N is flat or the V_a are parallel; `rank_one=True` therefore restricts it to
    $V_a = \alpha_a v$, a geodesic of one linear combination of the inputs: on a sphere,
    the limit of `manireg.fit`.

    **Arguments:** `source` an `Interval`, a `Box` or a `Euclidean` space; `target`,
    `x`, `y`, `weights` as for `manireg.fit`.

    **Example:**

    ```python
    data = mr.datasets.polar_wander("india")  # 33 poles: ages, unit vectors
    model = mr.baselines.geodesic_regression(
        mr.Interval(0, 320), mr.Sphere(2), data.ages, data.directions
    )
    model(65.0)
    ```
    """
    check_x64()
    check_source(source)
    if not source.linear:
        raise only_for("geodesic_regression", "Interval, Box, Euclidean", source)
    flat, outputs, weights = check_data(source, target, x, y, weights)
    centre = weights @ flat / jnp.sum(weights)
    # inputs of size 1, so the damping treats point and velocities alike
    scale = jnp.max(jnp.abs(flat - centre))
    points = outputs.reshape(-1, *target.point_shape)
    offset = (flat - centre) / scale
    best = _fit(target, offset, points, weights / jnp.sum(weights), rank_one)
    point, velocities, loss, result = best
    return GeodesicRegression(
        source, target, centre, point, velocities / scale, loss, result
    )


def _geodesic(target, point, velocities, offset: Float[Array, "n m"]):
    tangents = jnp.tensordot(offset, velocities, axes=1)
    return target.exp(jnp.broadcast_to(point, tangents.shape), tangents)


@eqx.filter_jit
def _fit(target: AbstractManifold, offset, y, weights, rank_one: bool):
    solver = optx.LevenbergMarquardt(rtol=1e-14, atol=1e-14)
    root = jnp.sqrt(weights)

    def on_manifold(parameters):
        point, factors, velocities = parameters
        point = target.project(point)
        if rank_one:
            velocities = jnp.tensordot(factors, velocities, axes=0)
        tangential = lambda v: target.tangent_projection(point, v)
        return point, jax.vmap(tangential)(velocities)

    def residuals(parameters, _):
        predicted = _geodesic(target, *on_manifold(parameters), offset)
        gaps = target.orthonormal(y, target.log(y, predicted))
        return root[:, None] * gaps.reshape(len(y), -1)

    def run(start):
        point, velocities = start
        factors = jnp.zeros(0)
        if rank_one:
            factors, velocities = _leading_factor(velocities)
        start = (point, factors, velocities)
        solution = optx.least_squares(
            residuals, solver, start, max_steps=MAX_STEPS, throw=False
        )
        loss = jnp.sum(residuals(solution.value, None) ** 2)
        return *on_manifold(solution.value), loss, solution.result

    fits = jax.lax.map(run, _starts(target, offset, y, weights))
    best = jnp.argmin(jnp.nan_to_num(fits[2], nan=jnp.inf))
    return jax.tree.map(lambda a: a[best], fits)


def _leading_factor(velocities: Float[Array, "m *point_shape"]):
    """Closest product alpha (x) v to m velocities."""
    flat = velocities.reshape(len(velocities), -1)
    u, s, vt = jnp.linalg.svd(flat, full_matrices=False)
    # a constant start still needs a direction to leave in
    return u[:, 0], (s[0] * vt[0]).reshape(velocities.shape[1:])


def _starts(target: AbstractManifold, offset, y, weights):
    """Points and velocities at offset 0: constant; linear regression of log_p y with
    all data; with the third of the data around each of several inputs, carried to 0."""
    k, m = offset.shape
    distance = jnp.sum(offset**2, axis=1)
    # inputs spread over the data: each the farthest from those before
    anchors = [jnp.argmin(distance)]
    gaps = jnp.full(k, jnp.inf)
    for _ in range(LOCAL_STARTS - 1):
        apart = jnp.sum((offset - offset[anchors[-1]]) ** 2, axis=1)
        gaps = jnp.minimum(gaps, apart)
        anchors.append(jnp.argmax(gaps))
    anchors = jnp.stack(anchors)
    count = min(k, max(2 * m + 2, k // 3))

    def linear(anchor, count):
        apart = jnp.sum((offset - offset[anchor]) ** 2, axis=1)
        _, nearest = jax.lax.top_k(-apart, count)
        base = y[anchor]
        logs = target.log(base[None], y[nearest]).reshape(count, -1)
        rows = (offset - offset[anchor])[nearest]
        design = jnp.concatenate([jnp.ones((count, 1)), rows], axis=1)
        root = jnp.sqrt(weights[nearest])[:, None]
        slopes = jnp.linalg.lstsq(root * design, root * logs)[0][1:]
        velocities = slopes.reshape(m, *target.point_shape)
        to_zero = lambda x: _geodesic(target, base, velocities, x[None])[0]
        point, carried = to_zero(-offset[anchor]), jax.jacfwd(to_zero)(-offset[anchor])
        return point, jnp.moveaxis(carried, -1, 0)

    local = jax.vmap(lambda a: linear(a, count))(anchors)
    whole = jax.vmap(lambda a: linear(a, k))(anchors[:1])
    still = (y[anchors[:1]], jnp.zeros((1, m, *target.point_shape)))
    return jax.tree.map(lambda *a: jnp.concatenate(a), still, whole, local)
