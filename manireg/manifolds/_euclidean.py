"""Euclidean space: the flat case, in which manifold regression is spline smoothing."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from .._source import Chart, bounding_box, itself
from ._base import AbstractManifold


class Euclidean(AbstractManifold):
    r"""$\mathbb{R}^n$: $\pi = \mathrm{id}$, $P = I$, $II = 0$, $d(p,q) = |p - q|$.

    **Example:**

    ```python
    mr.Euclidean(2).squared_distance(jnp.zeros(2), jnp.array([3.0, 4.0]))  # 25.0
    ```
    """

    dim: int = eqx.field(static=True)

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.dim,)

    @property
    def reach(self) -> float:
        return float("inf")

    @property
    def injectivity_radius(self) -> float:
        return float("inf")

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        return p

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return jnp.broadcast_arrays(p, v)[1]

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return jnp.zeros_like(p + u + v)

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return jnp.sum((p - q) ** 2, axis=-1)

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return p + v

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return q - p

    def covariant_derivative(
        self, psi: Sequence[Float[Array, "..."]]
    ) -> Float[Array, "..."]:
        return psi[-1]

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        return jax.random.normal(key, (n, self.dim))

    @property
    def linear(self) -> bool:
        return True

    def chart(self, around: np.ndarray | None) -> Chart:
        """The bounding box of the data."""
        low, high = bounding_box(self, around)
        return Chart(low, high, (False,) * self.dim, itself)
