"""The round sphere: the template to copy for a manifold with closed formulas."""

import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, ScalarLike

from .._algebra.series import (
    derivative_of_series,
    inner_of_series,
    inverse_root_of_series,
    product_of_series,
)
from .._algebra.smooth import (
    across,
    cos_sinc,
    norm_squared,
    off_zero,
    sphere_log,
    squared_angle,
)
from .._source import Atlas, Chart
from . import _sphere_rules as rules
from ._base import AbstractManifold
from ._membership import is_concrete


class Sphere(AbstractManifold):
    r"""$S^n(r) = \{p \in \mathbb{R}^{n+1} : |p| = r\}$; `Sphere(1)` is the circle.

    **Arguments:** `dim` the dimension n >= 1; `radius` (default 1), a float or a traced
    scalar.

    **Example:**

    ```python
    north, east = jnp.array([0.0, 0.0, 1.0]), jnp.array([1.0, 0.0, 0.0])
    sphere = mr.Sphere(2)
    jnp.sqrt(sphere.squared_distance(north, east))  # 1.5708
    sphere.log(north, east)  # 1.5708, 0.0, 0.0
    ```
    """

    dim: int = eqx.field(static=True)
    radius: ScalarLike = 1.0

    def __check_init__(self):
        if self.dim < 1:
            raise ValueError(f"Sphere: `dim` must be at least 1, found {self.dim}.")
        if is_concrete(self.radius) and not np.asarray(self.radius) > 0:
            raise ValueError(f"Sphere: `radius` must be positive, found {self.radius}.")

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.dim + 1,)

    @property
    def reach(self) -> ScalarLike:
        return self.radius

    @property
    def injectivity_radius(self) -> ScalarLike:
        return np.pi * self.radius

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""$r p / |p|$. At the origin, the medial axis, all points are as close: there
        it is the one on the first axis, without derivatives."""
        p = off_zero(p)
        return p * (self.radius * jax.lax.rsqrt(norm_squared(p)))[..., None]

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$v - \langle p, v \rangle p / |p|^2$."""
        return across(off_zero(p), v)

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$II_p(u, v) = -\langle u, v \rangle p / r^2$."""
        return -jnp.sum(u * v, axis=-1, keepdims=True) * p / self.radius**2

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$r^2 F(|p - q|^2 / r^2)$; near the cut locus (antipodes) continued linearly
        in the squared chord, see `manireg._algebra.smooth.squared_angle`."""
        return squared_angle(norm_squared(p - q) / self.radius**2) * self.radius**2

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\cos(|v|/r) p + r \sin(|v|/r) v / |v|$."""
        cosine, sinc = cos_sinc(norm_squared(v)[..., None] / self.radius**2)
        return cosine * p + sinc * v

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\frac{\theta}{\sin\theta} P_p q$ with $\theta = d(p, q)/r$, to rounding
        for all p, q. For antipodes (the cut locus), where every direction leads to q,
        it is one of them, of length $\pi r$."""
        return sphere_log(p, q, self.radius)

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """Uniform on the sphere."""
        return self.project(jax.random.normal(key, (n, self.dim + 1)))

    def covariant_derivative(
        self, psi: Sequence[Float[Array, " s"]]
    ) -> Float[Array, " s"]:
        """By power series: half the time of automatic differentiation, for order four a
        fifth."""
        psi = [off_zero(psi[0]), *psi[1:]]
        psi = [v / math.factorial(k) for k, v in enumerate(psi)]
        length = inverse_root_of_series(inner_of_series(psi, psi))
        gamma = [jnp.multiply(self.radius, v) for v in product_of_series(length, psi)]
        a = derivative_of_series(gamma)
        for _ in range(len(psi) - 2):
            a = derivative_of_series(a)
            along = [inner / self.radius**2 for inner in inner_of_series(a, gamma)]
            a = [v - w for v, w in zip(a, product_of_series(along, gamma))]
        return a[0]

    def chart(self, around: np.ndarray | None) -> Chart | None:
        """The angle, of the circle."""
        return rules.circle(self.radius) if self.dim == 1 else None

    def atlas(self, around: np.ndarray | None) -> Atlas:
        """The faces of a cube."""
        chart = self.chart(around)
        return rules.cube(self.dim, self.radius) if chart is None else chart.atlas()

    def even_points(self, n: int) -> tuple[np.ndarray, np.ndarray] | None:
        """The Fibonacci lattice, on S^2."""
        return rules.fibonacci(n, self.radius) if self.dim == 2 else None

    def exact_rule(self, n: int) -> tuple[np.ndarray, np.ndarray] | None:
        return rules.gauss(self.dim, n, self.radius) if self.dim > 1 else None
