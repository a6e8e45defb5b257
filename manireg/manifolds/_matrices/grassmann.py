"""Subspaces of R^n as orthogonal projectors."""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from ..._algebra.small import eigh, svd
from ..._algebra.smooth import norm_squared, squared_angle
from .._base import AbstractManifold
from .lines import line_log
from .matrix_exponentials import (
    log_by_halves,
    rotation_exp,
    squared_rotation_distance,
)
from .matrix_functions import (
    identity_like,
    off_diagonal,
    symmetric_part,
    top_eigenprojector,
)


class Grassmann(AbstractManifold):
    r"""The p-dimensional subspaces of $\mathbb{R}^n$, each stored as its orthogonal
    projector: $\{P \in \mathbb{R}^{n \times n} : P = P^T = P^2, \mathrm{tr} P = p\}$
    with the Frobenius metric. In principal angles, $d^2 = 2 \sum_i \theta_i^2$.

    **Arguments:** `n`, `p` with 1 <= p < n; `Grassmann(n, 1)` is projective space.

    **Example:** lines in the plane, 0.3 radians apart.

    ```python
    lines = mr.Grassmann(2, 1)
    v = jnp.array([jnp.cos(0.3), jnp.sin(0.3)])
    lines.squared_distance(jnp.diag(jnp.array([1.0, 0.0])), jnp.outer(v, v))  # 0.18
    ```
    """

    n: int = eqx.field(static=True)
    p: int = eqx.field(static=True)

    def __check_init__(self):
        if not 1 <= self.p < self.n:
            raise ValueError(
                f"Grassmann: needs 1 <= `p` < `n`, found p = {self.p}, n = {self.n}; "
                "with p = n there is one point only."
            )

    @property
    def dim(self) -> int:
        return self.p * (self.n - self.p)

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.n, self.n)

    @property
    def _has_one_angle(self) -> bool:
        return min(self.p, self.n - self.p) == 1

    @property
    def reach(self) -> float:
        return math.sqrt(0.5)

    @property
    def injectivity_radius(self) -> float:
        return math.sqrt(0.5) * math.pi

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""Projector on the leading p eigenvectors of $(p + p^T)/2$; one of several,
        without derivatives, where $\lambda_p = \lambda_{p+1}$."""
        return top_eigenprojector(symmetric_part(p), self.p)

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$P Z (I - P) + (I - P) Z P$ with $P = \pi(p)$, $Z = (v + v^T)/2$."""
        return off_diagonal(self.project(p), symmetric_part(v))

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$II_P(U, V) = (I - 2P)(UV + VU)$."""
        both = u @ v + v @ u
        return both - 2 * (p @ both)

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\frac14 |\log((I - 2q)(I - 2p))|_F^2$, smooth while all principal angles
        are below $\pi/2$, undefined from there on. With one principal angle (p = 1 or
        n - 1) it is $F(2|p - q|_F^2)/2$, continued linearly near $\pi/2$."""
        if self._has_one_angle:
            return squared_angle(2 * norm_squared(p - q, 2)) / 2
        return squared_rotation_distance(_reflection(p), _reflection(q)) / 4

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$e^W P e^{-W}$ with $W = [v, P]$."""
        vp = v @ p
        w = vp - vp.mT
        rotation = rotation_exp(w)
        return rotation @ p @ rotation.mT

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\sum_i \theta_i (u_i y_i^T + y_i u_i^T)$ with the principal angles
        $\theta_i$ and vectors $y_i$, $z_i = \cos\theta_i\, y_i + \sin\theta_i\, u_i$,
        to rounding for all p, q. Where an angle is $\pi/2$ (the cut locus) it is one of
        the geodesics."""
        if self.p == 1:
            return line_log(p, q)
        if self.p == self.n - 1:  # the line that is left over
            one = identity_like(p)
            return -line_log(one - p, one - q)
        return _log(p, q, self.p)

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """Uniform: projections of Gaussian symmetric matrices."""
        return self.project(jax.random.normal(key, (n, self.n, self.n)))


@functools.partial(jax.custom_jvp, nondiff_argnums=(2,))
def _log(p, q, rank):
    y, z = (eigh(x)[1][..., -rank:] for x in jnp.broadcast_arrays(p, q))
    left, cosines, right = svd(y.mT @ z)
    y, z = y @ left, z @ right.mT
    across = z - y * cosines[..., None, :]
    sines = jnp.sqrt(jnp.sum(across**2, axis=-2))
    angles = jnp.arctan2(sines, cosines)
    half = (across * (angles / jnp.where(sines > 0.0, sines, 1.0))[..., None, :]) @ y.mT
    return half + half.mT


@_log.defjvp
def _log_jvp(rank, primals, tangents):
    r"""From $[W, P]$ with $W = \frac12 \log((I - 2Q)(I - 2P))$: it is smooth where
    principal angles coincide, which their vectors are not."""

    def smooth(p, q):
        wp = log_by_halves(_reflection(q) @ _reflection(p)) @ p / 2
        return wp + wp.mT

    return _log(*primals, rank), jax.jvp(smooth, primals, tangents)[1]


def _reflection(p: Float[Array, "..."]) -> Float[Array, "..."]:
    return identity_like(p) - 2 * p
