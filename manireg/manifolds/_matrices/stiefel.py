"""Orthonormal frames of p vectors in R^n."""

import math

import equinox as eqx
import jax
from jaxtyping import Array, Float, PRNGKeyArray

from .._base import AbstractManifold
from .._defaults.logarithm import shooting_log, squared_shooting_distance
from .matrix_exponentials import rotation_exp
from .matrix_functions import (
    polar_factor,
    skew_part,
    symmetric_part,
)


class Stiefel(AbstractManifold):
    r"""$\{X \in \mathbb{R}^{n \times p} : X^T X = I\}$, p < n, with the embedded
    (Frobenius) metric; `Stiefel(n, 1)` is the unit sphere.

    **Arguments:** `n`, `p` with 1 <= p < n.

    **Example:**

    ```python
    frames = mr.Stiefel(3, 2)
    frames.project(jnp.array([[2.0, 0.0], [0.0, 3.0], [0.0, 0.0]])).sum()  # 2.0
    ```
    """

    n: int = eqx.field(static=True)
    p: int = eqx.field(static=True)

    def __check_init__(self):
        if self.p == self.n:
            raise ValueError(
                f"Stiefel: `p` equals `n` ({self.n}), which has two components; use "
                f"SpecialOrthogonal({self.n}) for the rotations."
            )
        if not 1 <= self.p < self.n:
            raise ValueError(
                f"Stiefel: needs 1 <= `p` < `n`, found p = {self.p}, n = {self.n}."
            )

    @property
    def dim(self) -> int:
        return self.n * self.p - self.p * (self.p + 1) // 2

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.n, self.p)

    @property
    def reach(self) -> float:
        return 1.0

    @property
    def injectivity_radius(self) -> float:
        """pi: Zimmermann & Stoye, arXiv:2405.02268 (2024)."""
        return math.pi

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""Polar factor $p\,(p^T p)^{-1/2}$; one of several, without derivatives, for
        rank-deficient p."""
        return polar_factor(p)

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$v - X\,\mathrm{sym}(X^T v)$ with $X = \pi(p)$."""
        x = polar_factor(p)
        return v - x @ symmetric_part(x.mT @ v)

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$II_X(U, V) = -X\,\mathrm{sym}(U^T V)$."""
        return -p @ symmetric_part(u.mT @ v)

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$|\log_p q|_F^2$, by shooting: reliable for distances below $\pi$."""
        return squared_shooting_distance(self, p, q)

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$e^{VX^T - XV^T} X e^{-X^T V}$ (Zimmermann & Hueper, SIAM J. Matrix Anal.
        Appl. 43, 2022, the Euclidean metric of their family)."""
        inner = skew_part(p.mT @ v)
        turn = v @ p.mT
        return rotation_exp(turn - turn.mT) @ p @ rotation_exp(-inner)

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """No closed formula: solves `exp(p, v) = q` for v by Newton shooting."""
        return shooting_log(self, p, q)

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """Uniform: the polar factors of Gaussian matrices."""
        return self.project(jax.random.normal(key, (n, self.n, self.p)))
