"""Exponential and logarithm of matrices, from operations whose derivatives are exact."""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._numerics import angle_over_sine, cos_sinc, norm_squared, squared_angle
from ._lapack import eigh
from ._matrix_functions import (
    adjoint,
    closest_rotation,
    identity_like,
    lyapunov,
    skew_part,
    symmetric_part,
)

_SQUARINGS = 6
_EXP_SERIES = [1 / math.factorial(k) for k in range(17)]
_LARGEST_TURN = 2.0**_SQUARINGS


def rotation_exp(w: Float[Array, "..."]) -> Float[Array, "..."]:
    """Matrix exponential of skew w. n = 2, 3: Rodrigues' formula. n > 3: Taylor of
    degree 16 and six squarings, exact to rounding for rotation angles up to 64 (NaN
    where |w|_F allows more); unlike `expm` it has no branches to differentiate."""
    one = identity_like(w)
    if w.shape[-1] == 1:
        return one
    angle2 = norm_squared(w, 2)[..., None, None] / 2
    if w.shape[-1] <= 3:
        _, sinc = cos_sinc(angle2)
        _, half_sinc = cos_sinc(angle2 / 4)
        return one + sinc * w + (half_sinc**2 / 2) * (w @ w)
    w = jnp.where(angle2 > _LARGEST_TURN**2, jnp.nan, w / _LARGEST_TURN)
    w2 = w @ w
    w3, w4 = w2 @ w, w2 @ w2
    total = _EXP_SERIES[16] * one
    for k in (12, 8, 4, 0):  # Paterson-Stockmeyer: Horner in w^4
        a, b, c, d = _EXP_SERIES[k : k + 4]
        total = total @ w4 + a * one + b * w + c * w2 + d * w3
    for _ in range(_SQUARINGS):
        total = total @ total
    return total


_ATAN_SERIES = [(-1) ** k / (2 * k + 1) for k in range(13)]
_HALVINGS = 3


def rotation_log(q: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""Skew logarithm of a rotation. n = 2, 3: $\frac{\theta}{\sin\theta} (q - q^T)/2$.
    n > 3: three square roots $\sqrt q = \mathrm{polar}(I + q)$, then $2\,
    \mathrm{artanh}$ of the Cayley transform $(q + I)^{-1}(q - I)$ as a power series.

    The derivatives are those of `closest_rotation`: finite for all angles below $\pi$.
    """
    one = identity_like(q)
    if q.shape[-1] <= 3:
        chord2 = norm_squared(q - one, 2)[..., None, None] / 2
        return angle_over_sine(chord2) * skew_part(q)
    for _ in range(_HALVINGS):
        q = closest_rotation(one + q)
    k = skew_part(jnp.linalg.solve(one + q, q - one))
    negative_square = adjoint(k) @ k
    total = _ATAN_SERIES[-1] * one
    for a in _ATAN_SERIES[-2::-1]:
        total = total @ negative_square + a * one
    return 2.0 ** (_HALVINGS + 1) * (k @ total)


def squared_rotation_distance(
    p: Float[Array, "..."], q: Float[Array, "..."]
) -> Float[Array, "..."]:
    r"""$|\log(p^T q)|_F^2$ for orthogonal p, q with $\det p = \det q$; for n = 2, 3 it
    is $2 F(|p - q|_F^2 / 2)$."""
    if p.shape[-1] <= 3:
        return 2 * squared_angle(norm_squared(p - q, 2) / 2)
    return norm_squared(rotation_log(adjoint(p) @ q), 2)


@jax.custom_jvp
def _square_root(s: Float[Array, "..."]) -> Float[Array, "..."]:
    values, vectors = eigh(s)
    return (vectors * jnp.sqrt(values)[..., None, :]) @ adjoint(vectors)


@_square_root.defjvp
def _square_root_jvp(primals, tangents):
    (s,), (ds,) = primals, tangents
    root = _square_root(s)
    return root, lyapunov(root, ds)


def symmetric_log(s: Float[Array, "..."]) -> Float[Array, "..."]:
    """Logarithm of a symmetric positive definite matrix: square roots until the series
    of artanh converges to rounding for condition numbers up to 1e12."""
    one = identity_like(s)
    scale = jnp.trace(s, axis1=-2, axis2=-1)[..., None, None] / s.shape[-1]
    s = s / scale
    halvings = 6
    for _ in range(halvings):
        s = _square_root(s)
    k = symmetric_part(jnp.linalg.solve(one + s, s - one))
    square = k @ k
    total = abs(_ATAN_SERIES[-1]) * one
    for a in _ATAN_SERIES[-2::-1]:
        total = total @ square + abs(a) * one
    return 2.0 ** (halvings + 1) * (k @ total) + jnp.log(scale) * one
