"""Rotations of R^n as matrices."""

import math

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from .._base import AbstractManifold
from .matrix_exponentials import rotation_exp, rotation_log, squared_rotation_distance
from .matrix_functions import (
    closest_rotation,
    skew_part,
)
from .turns import turn_rate


class SpecialOrthogonal(AbstractManifold):
    r"""$SO(n) = \{R \in \mathbb{R}^{n \times n} : R^T R = I, \det R = 1\}$ with the
    Frobenius metric; for n = 3 distances are $\sqrt 2$ times the rotation angle.

    **Arguments:** `n` >= 2, the size of the matrices.

    **Example:** a turn by 0.5 radians is $\sqrt 2 / 2$ from the identity.

    ```python
    turn = jnp.array(Rotation.from_rotvec([0.0, 0.0, 0.5]).as_matrix())
    so3 = mr.SpecialOrthogonal(3)
    jnp.sqrt(so3.squared_distance(jnp.eye(3), turn))  # 0.7071
    ```
    """

    n: int = eqx.field(static=True)

    def __check_init__(self):
        if self.n < 2:
            raise ValueError(
                f"SpecialOrthogonal: `n` must be at least 2, found {self.n}."
            )

    @property
    def dim(self) -> int:
        return self.n * (self.n - 1) // 2

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.n, self.n)

    @property
    def reach(self) -> float:
        return math.sqrt(2.0)

    @property
    def injectivity_radius(self) -> float:
        return math.sqrt(2.0) * math.pi

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""Closest rotation $U \mathrm{diag}(1, \dots, 1, \det UV^T) V^T$ of
        $p = U S V^T$; one of several, without derivatives, where
        $s_{n-1} + \mathrm{sign}(\det p) s_n = 0$ (as at reflections)."""
        return closest_rotation(p)

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$R\,\mathrm{skew}(R^T v)$ with $R = \pi(p)$."""
        r = closest_rotation(p)
        return r @ skew_part(r.mT @ v)

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$II_R(RA, RB) = R(AB + BA)/2$ for skew A, B."""
        return (u @ p.mT @ v + v @ p.mT @ u) / 2

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$|\log(p^T q)|_F^2$. For n = 2, 3 this is $2F(|p - q|_F^2/2)$, continued
        linearly in the squared chord near the cut locus (rotation angle $\pi$), see
        `manireg._algebra.smooth.squared_angle`; for n > 3 it is
        undefined where a rotation angle of $p^T q$ is $\pi$."""
        return squared_rotation_distance(p, q)

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$p \exp(p^T v)$."""
        return p @ rotation_exp(skew_part(p.mT @ v))

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$p \log(p^T q)$, to rounding for all p, q (n > 3: to 1e-8 where a rotation
        angle of $p^T q$ is next to $\pi$). For half turns (the cut locus) it is one of
        the geodesics."""
        return p @ rotation_log(p.mT @ q)

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """Haar measure: the closest rotations of Gaussian matrices."""
        return self.project(jax.random.normal(key, (n, self.n, self.n)))

    def angular_velocity(
        self, p: Float[Array, "..."], v: Float[Array, "..."], axes: str
    ) -> Float[Array, "... 3"]:
        """Of rotations of space, n = 3."""
        if self.n != 3:
            raise ValueError(
                f"angular_velocity: only of maps into SpecialOrthogonal(3), found "
                f"SpecialOrthogonal({self.n})."
            )
        return turn_rate(p, v, axes)

    def mistake(self, points: np.ndarray) -> tuple[Bool[np.ndarray, " k"], str, str]:
        """Reflections."""
        return (
            np.linalg.det(points) < 0,
            "matrices are reflections, not rotations of {}: their determinant is negative",
            "An axis is mirrored or two are swapped, which no projection mends: change "
            "the sign of that row or column, or leave these points out.",
        )
