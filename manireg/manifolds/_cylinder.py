"""The infinite circular cylinder."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float, PRNGKeyArray, ScalarLike

from .._algebra.smooth import (
    across,
    cos_sinc,
    norm_squared,
    off_zero,
    sphere_log,
    squared_angle,
)
from .._source import Chart, bounding_box
from ._base import AbstractManifold
from ._membership import is_concrete


class Cylinder(AbstractManifold):
    r"""$\{(x, y, z) : x^2 + y^2 = r^2\} \subset \mathbb{R}^3$, isometric to a strip;
    all formulas are those of the circle in $(x, y)$ and of the line in z.

    **Arguments:** `radius` (default 1), a float or a traced scalar.

    **Example:**

    ```python
    cylinder = mr.Cylinder(2.0)
    cylinder.project(jnp.array([3.0, 4.0, 7.0]))  # 1.2, 1.6, 7.0
    ```
    """

    radius: ScalarLike = 1.0

    def __check_init__(self):
        if is_concrete(self.radius) and not np.asarray(self.radius) > 0:
            raise ValueError(
                f"Cylinder: `radius` must be positive, found {self.radius}."
            )

    @property
    def dim(self) -> int:
        return 2

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (3,)

    @property
    def reach(self) -> ScalarLike:
        return self.radius

    @property
    def injectivity_radius(self) -> ScalarLike:
        return np.pi * self.radius

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""$(r x/\rho, r y/\rho, z)$, $\rho^2 = x^2 + y^2$; on the axis, where a whole
        circle is as close, $(r, 0, z)$, without derivatives in x and y."""
        plane, z = off_zero(p[..., :2]), p[..., 2:]
        rho = jnp.linalg.norm(plane, axis=-1, keepdims=True)
        return jnp.concatenate([self.radius * plane / rho, z], axis=-1)

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$v - (v_x x + v_y y)(x, y, 0)/\rho^2$."""
        return across(off_zero(p * _PLANE), v)

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$-(u_x v_x + u_y v_y)(x, y, 0)/r^2$."""
        bend = jnp.sum(u * v * _PLANE, axis=-1, keepdims=True)
        return -bend * p * _PLANE / self.radius**2

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$r^2 F(q/r^2) + (z_p - z_q)^2$, q the squared chord in (x, y)."""
        gap = p - q
        chord2 = norm_squared(gap * _PLANE) / self.radius**2
        return gap[..., 2] ** 2 + self.radius**2 * squared_angle(chord2)

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """A helix: the circle's geodesic in (x, y), a straight line in z."""
        turn = norm_squared(v * _PLANE)[..., None] / self.radius**2
        cosine, sinc = cos_sinc(turn)
        return (cosine * p + sinc * v) * _PLANE + (p + v) * (1.0 - _PLANE)

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\frac{\theta}{\sin\theta} P_p q$ in (x, y) and $z_q - z_p$, to rounding
        for all p, q. Where q is opposite (the cut locus), one of the two ways round."""
        circle = sphere_log(p[..., :2], q[..., :2], self.radius)
        return jnp.concatenate([circle, (q - p)[..., 2:]], axis=-1)

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """Uniform around the axis, standard normal along it."""
        return self.project(jax.random.normal(key, (n, 3)))

    def chart(self, around: np.ndarray | None) -> Chart:
        """Angle and height, cut to the data."""
        low, high = bounding_box(self, None if around is None else around[:, 2:])
        embed = Partial(_embed, np.asarray(self.radius, float))
        ends = np.append(0.0, low), np.append(2 * np.pi, high)
        return Chart(*ends, (True, False), embed)


def _embed(radius, u):
    return jnp.array([radius * jnp.cos(u[0]), radius * jnp.sin(u[0]), u[1]])


_PLANE = np.array([1.0, 1.0, 0.0])  # keeps (x, y), drops z
