"""The ellipsoid, in any dimension."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, ScalarLike

from ._base import AbstractManifold
from ._defaults.implicit import implicit_solution
from ._defaults.logarithm import shooting_log, squared_shooting_distance
from ._defaults.second_form import broadcast_points, geodesic_exp
from ._membership import is_concrete


class Ellipsoid(AbstractManifold):
    r"""$\{p \in \mathbb{R}^s : \sum_i p_i^2 / a_i^2 = 1\}$, s >= 2.

    **Arguments:** `axes` the semi-axes a, `(s,)`; differentiable.

    **Example:**

    ```python
    globe = mr.Ellipsoid(jnp.array([6378.137, 6378.137, 6356.752]))  # WGS 84, km
    globe.project(jnp.array([0.0, 0.0, 7000.0]))  # 0.0, 0.0, 6356.752
    ```
    """

    axes: Float[Array, " s"] = eqx.field(converter=lambda a: jnp.asarray(a, float))

    def __check_init__(self):
        if self.axes.ndim != 1 or self.axes.shape[0] < 2:
            raise ValueError(
                "Ellipsoid: `axes` must be a vector of at least 2 semi-axes, found "
                f"shape {self.axes.shape}."
            )
        if is_concrete(self.axes) and not np.all(np.asarray(self.axes) > 0):
            raise ValueError(f"Ellipsoid: `axes` must be positive, found {self.axes}.")

    @property
    def dim(self) -> int:
        return self.axes.shape[0] - 1

    @property
    def point_shape(self) -> tuple[int, ...]:
        return self.axes.shape

    @property
    def reach(self) -> ScalarLike:
        r"""$a_{\min}^2 / a_{\max}$, the smallest radius of curvature."""
        return jnp.min(self.axes) ** 2 / jnp.max(self.axes)

    @property
    def injectivity_radius(self) -> ScalarLike:
        r"""The lower bound $\pi a_{\min}^2 / a_{\max}$: no geodesic curves more than
        $\kappa = 1/\text{reach}$, so a closed one is no shorter than $2\pi/\kappa$, and
        conjugate points are no closer than $\pi/\kappa$."""
        return np.pi * self.reach

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""$y_i = a_i^2 p_i / (a_i^2 - a_{\min}^2 + t)$, t the largest root of the secular
        equation $\sum_i (a_i p_i / (a_i^2 - a_{\min}^2 + t))^2 = 1$. On the medial axis,
        a piece of the plane $p_{\min} = 0$, it is the point with $y_{\min} > 0$, without
        derivatives."""
        return _project(self, p)

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$v - \langle \nu, v \rangle \nu / |\nu|^2$, $\nu_i = \pi(p)_i / a_i^2$."""
        normal = self.project(p) / self.axes**2
        along = jnp.sum(normal * v, axis=-1, keepdims=True)
        return v - along * normal / jnp.sum(normal**2, axis=-1, keepdims=True)

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$-\big(\sum_i u_i v_i / a_i^2\big) \nu / |\nu|^2$, $\nu_i = p_i / a_i^2$."""
        normal = p / self.axes**2
        bend = jnp.sum(u * v / self.axes**2, axis=-1, keepdims=True)
        return -bend * normal / jnp.sum(normal**2, axis=-1, keepdims=True)

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
        """The image of the uniform distribution on the sphere under the scaling by the
        axes: of full support, denser where the ellipsoid is strongly curved."""
        x = jax.random.normal(key, (n, *self.point_shape))
        return self.axes * x / jnp.linalg.norm(x, axis=-1, keepdims=True)


@eqx.filter_jit
def _project(ellipsoid: Ellipsoid, p: Array) -> Array:
    axes = ellipsoid.axes

    def project(p):
        p = p + _TINY * axes  # off the medial axis
        t = implicit_solution(_largest_root, _secular, axes, p)
        return axes**2 * p / (_excess(axes) + t)

    return broadcast_points(project, axes.shape)(p)


_TINY = 1e-100  # lost in rounding beside what is not 0


def _excess(axes: Array) -> Array:
    """$a_i^2 - a_{\\min}^2$."""
    least = jnp.min(axes)
    return (axes - least) * (axes + least)


def _secular(t: Array, axes: Array, p: Array) -> Array:
    return jnp.sum((axes * p / (_excess(axes) + t)) ** 2, keepdims=True) - 1.0


def _largest_root(axes: Array, p: Array) -> Array:
    """Newton's method from the left, where the secular function is convex, decreasing
    and, thanks to the start, between 0 and s - 1: it cannot overshoot."""

    def move(state):
        t, _, count = state
        value, slope = jax.jvp(lambda t: _secular(t, axes, p), (t,), (jnp.ones(1),))
        return t - value / slope, jnp.max(jnp.abs(value / slope)), count + 1

    def moving(state):
        t, moved, count = state
        return (moved > 2e-16 * jnp.max(t)) & (count < 60)

    start = jnp.max(axes * jnp.abs(p) - _excess(axes), keepdims=True)
    return jax.lax.while_loop(moving, move, (start, jnp.array(jnp.inf), 0))[0]
