"""Exponential and logarithm of matrices, from operations whose derivatives are exact."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._algebra.small import eigh
from ..._algebra.smooth import (
    RIGHT_ANGLE,
    angle_over_sine,
    cos_sinc,
    cosh_sinhc,
    norm_squared,
    squared_angle,
)
from .lines import leading_vector
from .matrix_functions import (
    Eigen,
    closest_rotation,
    identity_like,
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
    return _exp(jnp.where(angle2 > _LARGEST_TURN**2, jnp.nan, w))


def symmetric_exp(s: Float[Array, "..."]) -> Float[Array, "..."]:
    """Matrix exponential of a symmetric matrix, to rounding where its eigenvalues differ
    by 64 or less: the trace is taken off first."""
    one = identity_like(s)
    mean = jnp.trace(s, axis1=-2, axis2=-1)[..., None, None] / s.shape[-1]
    rest = s - mean * one
    if s.shape[-1] == 1:
        return jnp.exp(s)
    if s.shape[-1] == 2:  # a multiple of the identity when squared
        cosine, sine = cosh_sinhc(norm_squared(rest, 2)[..., None, None] / 2)
        return jnp.exp(mean) * (cosine * one + sine * rest)
    return jnp.exp(mean) * symmetric_part(_exp(rest))


def _exp(w: Float[Array, "..."]) -> Float[Array, "..."]:
    one, w = identity_like(w), w / _LARGEST_TURN
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
    r"""Skew logarithm of a rotation, with angles of at most $\pi$, to rounding for all
    rotations of n = 2, 3. Where an angle is $\pi$, one of several.

    n = 2: $\mathrm{atan2}(\sin\theta, \cos\theta)$. n = 3: $\frac{\theta}{\sin\theta}
    (q - q^T)/2$ up to a right angle; beyond, the axis a is read from the symmetric part
    $\cos\theta\, I + (1 - \cos\theta) aa^T$. n > 3: `_log_of_large`, next to a half turn
    mended by one step of Newton's method.
    """
    if q.shape[-1] > 3:
        return _log_of_large(q)
    trace = jnp.trace(q, axis1=-2, axis2=-1)[..., None, None]
    if q.shape[-1] == 2:
        sine2 = q[..., 1:, :1] - q[..., :1, 1:]
        return jnp.arctan2(sine2, trace) * _QUARTER_TURN
    chord2 = norm_squared(q - identity_like(q), 2)[..., None, None] / 2
    near = chord2 < RIGHT_ANGLE
    cosine = (trace - 1.0) / 2
    rank_one = jnp.where(near, 1.0, symmetric_part(q) - cosine * identity_like(q))
    axis = leading_vector(rank_one)
    turn = jnp.tensordot(axis, _CROSS, 1)  # about the axis, by the angle 1
    sine = jnp.sum(turn * q, axis=(-2, -1))[..., None, None] / 2
    angle = jnp.arctan2(sine, jnp.where(near, 1.0, cosine))
    return jnp.where(near, angle_over_sine(chord2) * skew_part(q), angle * turn)


_QUARTER_TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
_CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)  # [k] v = e_k x v


def _log_of_large(q: Float[Array, "..."]) -> Float[Array, "..."]:
    """`log_by_halves`, to 1e-8 also where q is next to half turns: there it turns the
    planes of the eigenvectors of q + q^T in a direction that q leaves open, a little, and
    takes off again what that was too much."""
    values, vectors = eigh(jax.lax.stop_gradient(symmetric_part(q)))
    pairs = vectors[..., : q.shape[-1] // 2 * 2]
    first, second = pairs[..., ::2], pairs[..., 1::2]
    planes = second @ first.mT - first @ second.mT
    half_turn = values[..., :1, None] < _HALF_TURN
    w = log_by_halves(q, jnp.where(half_turn, _NUDGE * planes, 0.0))
    excess = skew_part(rotation_exp(w).mT @ q)
    return w + jnp.where(half_turn, excess, 0.0)


_NUDGE = 1e-8
_HALF_TURN = -1.0 + 1e-12  # as a cosine


def log_by_halves(
    q: Float[Array, "..."], nudge: Float[Array, "..."] | float = 0.0
) -> Float[Array, "..."]:
    r"""Three square roots $\sqrt q = \mathrm{polar}(I + q)$, then $2\, \mathrm{artanh}$
    of the Cayley transform $(q + I)^{-1}(q - I)$ as a power series. The derivatives are
    those of `closest_rotation`: finite for all angles below $\pi$."""
    one = identity_like(q)
    q = closest_rotation(one + q + nudge)
    for _ in range(_HALVINGS - 1):
        q = closest_rotation(one + q)
    k = skew_part(jnp.linalg.solve(one + q, q - one))
    negative_square = k.mT @ k
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
    return norm_squared(log_by_halves(p.mT @ q), 2)


def symmetric_log(s: Float[Array, "..."]) -> Float[Array, "..."]:
    """Logarithm of a symmetric positive definite matrix, by eigenvalues; derivatives of
    all orders are exact, also where these are repeated, and where they differ by factors
    up to 1e12."""
    return _log(s)[0]


@jax.custom_jvp
def _log(s: Float[Array, "..."]) -> tuple[Float[Array, "..."], Eigen]:
    """With its own eigenvalues and eigenvectors."""
    values, vectors = eigh(s)
    values = jnp.log(values)
    return (vectors * values[..., None, :]) @ vectors.mT, (values, vectors)


@_log.defjvp
def _log_jvp(primals, tangents):
    (s,), (ds,) = primals, tangents
    log, eigen = _log(s)
    constant = jax.tree.map(jnp.zeros_like, eigen)
    return (log, eigen), (_from_exponential(log, eigen, ds), constant)


def _from_exponential(
    log: Float[Array, "..."], eigen: Eigen, k: Float[Array, "..."]
) -> Float[Array, "..."]:
    """X with D exp(log)[X] = k: a linear solve to JAX, as `lyapunov` is."""
    values, vectors = jax.lax.stop_gradient(eigen)
    mean = (values[..., :, None] + values[..., None, :]) / 2
    half = (values[..., :, None] - values[..., None, :]) / 2
    divided = jnp.exp(mean) * cosh_sinhc(half**2)[1]

    def solve(_, k):
        inside = (vectors.mT @ k @ vectors) / divided
        return vectors @ inside @ vectors.mT

    forward = lambda x: jax.jvp(symmetric_exp, (log,), (x,))[1]
    return jax.lax.custom_linear_solve(forward, k, solve, symmetric=True)
