"""The torus of revolution, curved and with geodesics that only integration gives."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float, PRNGKeyArray, ScalarLike

from .._algebra.smooth import off_zero
from .._source import Chart
from ._base import AbstractManifold
from ._defaults.logarithm import shooting_log, squared_shooting_distance
from ._defaults.second_form import geodesic_exp
from ._membership import is_concrete


class Torus(AbstractManifold):
    r"""$((R + r\cos\theta)\cos\varphi, (R + r\cos\theta)\sin\varphi, r\sin\theta)$ in
    $\mathbb{R}^3$: a tube of radius r about a circle of radius R, the core.

    **Arguments:** `R` the radius of the core, `r` < R the radius of the tube, floats
    or traced scalars.

    **Example:**

    ```python
    torus = mr.Torus(2.0, 0.5)
    torus.project(jnp.array([4.0, 0.0, 0.0]))  # 2.5, 0.0, 0.0
    ```
    """

    R: ScalarLike = 2.0
    r: ScalarLike = 1.0

    def __check_init__(self):
        R, r = self.R, self.r
        if is_concrete(R, r) and not 0 < np.asarray(r) < np.asarray(R):
            raise ValueError(
                "Torus: `r` must be positive and smaller than `R`, or the surface meets "
                f"itself; found {r} and {R}."
            )

    @property
    def dim(self) -> int:
        return 2

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (3,)

    @property
    def reach(self) -> ScalarLike:
        r"""$\min(r, R - r)$: to the core, or to the axis."""
        return jnp.minimum(self.r, jnp.subtract(self.R, self.r))

    @property
    def injectivity_radius(self) -> ScalarLike:
        r"""$\pi\min(r, R - r)$, half the shortest closed geodesic: a meridian or the
        inner equator (conjugate points are no closer than $\pi\sqrt{r(R + r)}$)."""
        return np.pi * self.reach

    def _tube(self, p: Array) -> tuple[Array, Array, Array]:
        r"""Distance of p to the axis, unit vector away from it $(.., 2)$, and
        $(\cos\theta, \sin\theta)$."""
        rho = jnp.linalg.norm(off_zero(p[..., :2]), axis=-1, keepdims=True)
        away = off_zero(p[..., :2]) / rho
        # measured across the core, so that the normal is one also where it is rounding
        out = jnp.sum(p[..., :2] * away, axis=-1, keepdims=True) - self.R
        turn = off_zero(jnp.concatenate([out, p[..., 2:]], axis=-1))
        return rho, away, turn / jnp.linalg.norm(turn, axis=-1, keepdims=True)

    def _normal(self, p: Array) -> Array:
        _, away, turn = self._tube(p)
        return jnp.concatenate([turn[..., :1] * away, turn[..., 1:]], axis=-1)

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""$c + r (p - c)/|p - c|$, c the closest point of the core. On the core and on
        the axis, where a whole circle is as close, it is the point farthest from the
        axis and that of $\varphi = 0$, without derivatives across."""
        _, away, turn = self._tube(p)
        ring = (self.R + self.r * turn[..., :1]) * away
        return jnp.concatenate([ring, self.r * turn[..., 1:]], axis=-1)

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$v - \langle \nu, v \rangle \nu$, $\nu = (p - c)/|p - c|$."""
        normal = self._normal(p)
        return v - jnp.sum(normal * v, axis=-1, keepdims=True) * normal

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$-\big(\langle u, v \rangle / r + (\cos\theta/\rho - 1/r) u_\varphi
        v_\varphi\big) \nu$: principal curvatures $-1/r$ along the meridian and
        $-\cos\theta/\rho$ along the parallel, $\rho = R + r\cos\theta$."""
        rho = jnp.linalg.norm(p[..., :2], axis=-1, keepdims=True)
        normal = self._normal(p)
        cosine = (rho - self.R) / self.r
        u_phi = (p[..., :1] * u[..., 1:2] - p[..., 1:2] * u[..., :1]) / rho
        v_phi = (p[..., :1] * v[..., 1:2] - p[..., 1:2] * v[..., :1]) / rho
        meridian = jnp.sum(u * v, axis=-1, keepdims=True) / self.r
        parallel = (cosine / rho - 1.0 / self.r) * u_phi * v_phi
        return -(meridian + parallel) * normal

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
        r"""Uniform by area: a uniform $\theta$ becomes $\pi - \theta$ with the
        probability that turns its density into $1 + (r/R)\cos\theta$."""
        k1, k2, k3 = jax.random.split(key, 3)
        phi = jax.random.uniform(k1, (n,), maxval=2 * np.pi)
        theta = jax.random.uniform(k2, (n,), maxval=2 * np.pi)
        keep = (1.0 + self.r / self.R * jnp.cos(theta)) / 2.0
        theta = jnp.where(jax.random.uniform(k3, (n,)) < keep, theta, np.pi - theta)
        rho = self.R + self.r * jnp.cos(theta)
        return jnp.stack(
            [rho * jnp.cos(phi), rho * jnp.sin(phi), self.r * jnp.sin(theta)], -1
        )

    def chart(self, around: np.ndarray | None) -> Chart:
        r"""$(\varphi, \theta)$."""
        embed = Partial(_embed, np.asarray(self.R, float), np.asarray(self.r, float))
        return Chart(np.zeros(2), np.full(2, 2 * np.pi), (True, True), embed)


def _embed(R, r, u):
    rho = R + r * jnp.cos(u[1])
    return jnp.array([rho * jnp.cos(u[0]), rho * jnp.sin(u[0]), r * jnp.sin(u[1])])
