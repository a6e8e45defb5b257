"""Manifolds given by equations: one function, the rest by automatic differentiation."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, ScalarLike

from .._algebra.small import eigh
from .._algebra.smooth import norm_squared
from ._base import AbstractManifold
from ._defaults.implicit import implicit_solution
from ._defaults.logarithm import shooting_log, squared_shooting_distance
from ._defaults.second_form import broadcast_points, geodesic_exp

_STEP_SIZES = (1.0, 0.5, 0.2, 0.05)  # of Newton steps, tried at once


class LevelSet(AbstractManifold):
    r"""$\{p \in \mathbb{R}^s : F(p) = 0\}$ for a smooth $F: \mathbb{R}^s \to
    \mathbb{R}^q$ whose derivative $DF$ has rank q there; the dimension is s - q.

    **Arguments:** `function` F, of one point `(s,)`, with a scalar or `(q,)` result,
    any callable JAX can differentiate twice (an `eqx.Module` if it has parameters to
    differentiate or vmap); `ambient_dim` s; `reach`, estimated if not given; `center`
    (default 0) and `scale` (default 1), the mean and standard deviation of the normal
    distribution whose projection is `random_points`.

    **Example:** the unit sphere again.

    ```python
    sphere = mr.LevelSet(lambda p: p @ p - 1, 3)
    sphere.project(jnp.array([0.0, 0.0, 1.2]))  # 0.0, 0.0, 1.0
    ```
    """

    function: Callable[[Array], Array]
    center: Float[Array, " s"]
    scale: ScalarLike
    known_reach: ScalarLike | None
    ambient_dim: int = eqx.field(static=True)
    dim: int = eqx.field(static=True)

    def __init__(
        self,
        function: Callable[[Array], Array],
        ambient_dim: int,
        *,
        reach: ScalarLike | None = None,
        center: ScalarLike | Float[Array, " s"] = 0.0,
        scale: ScalarLike = 1.0,
    ):
        self.function = function
        self.ambient_dim = ambient_dim
        self.center = jnp.broadcast_to(jnp.asarray(center, float), (ambient_dim,))
        self.scale = scale
        self.known_reach = reach
        value = eqx.filter_eval_shape(function, self.center)
        if value.ndim > 1:
            raise ValueError(
                "LevelSet: `function` must map a point to a scalar or a vector, found "
                f"a result of shape {value.shape}."
            )
        self.dim = ambient_dim - value.size

    def __check_init__(self):
        if self.dim < 1:
            raise ValueError(
                f"LevelSet: {self.ambient_dim - self.dim} equations in "
                f"R^{self.ambient_dim} leave no manifold of positive dimension; use "
                "fewer equations or raise `ambient_dim`."
            )

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.ambient_dim,)

    @property
    def reach(self) -> ScalarLike:
        r"""As given, else estimated from 200 random points: the smallest of
        $|q - p|^2 / (2 |(I - P_p)(q - p)|)$ over their pairs (Federer's formula for the
        reach, an infimum over all pairs) and of the radii of curvature at them. Errs
        upwards, by a few percent where the points are dense."""
        if self.known_reach is not None:
            return self.known_reach
        return _estimated_reach(self)

    @property
    def injectivity_radius(self) -> ScalarLike:
        r"""The lower bound $\pi \cdot$ `reach`: no geodesic curves more than
        $\kappa = 1/\text{reach}$, so a closed one is no shorter than $2\pi/\kappa$, and
        conjugate points are no closer than $\pi/\kappa$."""
        return np.pi * self.reach

    def _equations(self, p: Array) -> Array:
        return jnp.ravel(self.function(p))

    def _normal_part(self, p: Array, v: Array) -> Array:
        """$DF^+ DF v$ with $DF^+ = DF^T (DF\\, DF^T)^{-1}$, at a point p of N."""
        derivative = jax.jacfwd(self._equations)(p)
        return _lift(derivative, derivative @ v)

    def _bend(self, p: Array, u: Array, v: Array) -> Array:
        def along_u(x):
            return jax.jvp(self._equations, (x,), (u,))[1]

        return -_lift(jax.jacfwd(self._equations)(p), jax.jvp(along_u, (p,), (v,))[1])

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""The closest point y with its multiplier $\mu$: $y - p + DF(y)^T \mu = 0$,
        $F(y) = 0$. Newton's method for the distance along N, restoring F = 0 after each
        step, from the point to which Gauss-Newton steps for F = 0 carry p. NaN where these
        meet a singular DF (the centre of a sphere); on the medial axis no promise."""
        return _project(self, p)

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$v - DF^+ DF v$ at $\pi(p)$, $DF^+ = DF^T (DF\, DF^T)^{-1}$."""
        normal = broadcast_points(self._normal_part, self.point_shape)
        return v - normal(self.project(p), v)

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$-DF^+ D^2F[u, v]$."""
        return broadcast_points(self._bend, self.point_shape)(p, u, v)

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$|\log_p q|^2$."""
        return squared_shooting_distance(self, p, q)

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """By `geodesic_exp`."""
        return geodesic_exp(self, p, v)

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """By `shooting_log`."""
        return shooting_log(self, p, q)

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """Projections of normal random points of mean `center` and standard deviation
        `scale`: of full support, not uniform."""
        noise = jax.random.normal(key, (n, self.ambient_dim))
        return self.project(self.center + self.scale * noise)


@eqx.filter_jit
def _project(manifold: LevelSet, p: Array) -> Array:
    def project(p):
        solution = implicit_solution(_closest_point, _lagrange, manifold, p)
        return solution[: manifold.ambient_dim]

    return broadcast_points(project, manifold.point_shape)(p)


def _lift(derivative: Array, value: Array) -> Array:
    return derivative.T @ jnp.linalg.solve(derivative @ derivative.T, value)


def _lagrange(solution: Array, manifold: LevelSet, p: Array) -> Array:
    y, multiplier = jnp.split(solution, [manifold.ambient_dim])
    value, pullback = jax.vjp(manifold._equations, y)
    return jnp.concatenate([y - p + pullback(multiplier)[0], value])


def _restore(manifold: LevelSet, y: Array) -> Array:
    """Gauss-Newton steps, of the best of a few lengths, until F(y) = 0."""

    def move(state):
        y, _, count = state
        derivative = jax.jacfwd(manifold._equations)(y)
        step = _lift(derivative, manifold._equations(y))
        tries = y - sizes[:, None] * step
        values = jax.vmap(manifold._equations)(tries)
        best = jnp.argmin(jnp.sum(values**2, axis=1))
        return tries[best], jnp.sum(step**2), count + 1

    def moving(state):
        y, moved, count = state
        return (moved > 1e-28 * jnp.sum(y**2)) & (count < 30)

    sizes = jnp.array(_STEP_SIZES)
    return jax.lax.while_loop(moving, move, (y, jnp.array(jnp.inf), 0))[0]


def _closest_point(manifold: LevelSet, p: Array) -> Array:
    def multiplier(y, derivative):
        return jnp.linalg.solve(derivative @ derivative.T, derivative @ (p - y))

    def move(state):
        y, distance, _, count = state
        derivative = jax.jacfwd(manifold._equations)(y)
        mu = multiplier(y, derivative)
        bend = jax.hessian(lambda y: mu @ manifold._equations(y))(y)
        tangent = jnp.eye(p.size) - _lift(derivative, derivative)
        # I - A on the tangent space, made positive: descent also beyond the reach
        size, frame = eigh(jnp.eye(p.size) + tangent @ bend @ tangent)
        pull = frame.T @ (tangent @ (p - y)) / jnp.maximum(jnp.abs(size), 0.1)
        step = tangent @ (frame @ pull)
        tries = jax.vmap(lambda a: _restore(manifold, y + a * step))(sizes)
        distances = jnp.sum((tries - p) ** 2, axis=1)
        best = jnp.argmin(distances)
        closer = distances[best] < distance
        moved = jnp.where(closer, jnp.sum((tries[best] - y) ** 2), 0.0)
        y, distance = jax.lax.cond(
            closer,
            lambda: (tries[best], distances[best]),
            lambda: (y, distance),
        )
        return y, distance, moved, count + 1

    def moving(state):
        y, _, moved, count = state
        return ((moved > 1e-18 * jnp.sum(y**2)) | (count == 1)) & (count < 100)

    def polish(_, solution):
        residual = _lagrange(solution, manifold, p)
        jacobian = jax.jacfwd(_lagrange)(solution, manifold, p)
        return solution - jnp.linalg.solve(jacobian, residual)

    sizes = jnp.array(_STEP_SIZES)
    far = jnp.array(jnp.inf, p.dtype)  # the first step is 0: it restores F = 0 only
    y = jax.lax.while_loop(moving, move, (p, far, far, 0))[0]
    mu = multiplier(y, jax.jacfwd(manifold._equations)(y))
    return jax.lax.fori_loop(0, 3, polish, jnp.concatenate([y, mu]))


@eqx.filter_jit
def _estimated_reach(manifold: LevelSet) -> Array:
    key, key_u = jax.random.split(jax.random.key(0))
    p = manifold.random_points(key, 200)
    gap = p[None] - p[:, None]
    normal = broadcast_points(manifold._normal_part, manifold.point_shape)
    offset = jnp.sqrt(norm_squared(normal(p[:, None], gap)))
    pairs = norm_squared(gap) / (2 * jnp.where(offset > 0, offset, jnp.nan))
    u = jax.random.normal(key_u, (100, 1, manifold.ambient_dim))
    u = u - normal(p, u)
    u = u / jnp.sqrt(norm_squared(u))[..., None]
    curvature = jnp.sqrt(norm_squared(manifold.second_fundamental_form(p, u, u)))
    return jnp.minimum(jnp.nanmin(pairs), 1.0 / jnp.max(curvature))
