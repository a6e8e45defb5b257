"""Lines through 0 in real or complex space, as their orthogonal projectors z z^*."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Inexact

from ..._algebra.smooth import RIGHT_ANGLE, angle_over_sine, norm_squared
from .matrix_functions import adjoint, off_diagonal, symmetric_part


def leading_vector(a: Inexact[Array, "..."]) -> Inexact[Array, "..."]:
    """The unit vector z, up to its phase, of the matrix c z z^*, c > 0."""
    diagonal = jnp.diagonal(a.real, axis1=-2, axis2=-1)
    longest = jnp.argmax(diagonal, axis=-1)[..., None, None]
    column = jnp.take_along_axis(a, longest, axis=-1)[..., 0]
    return column / jnp.sqrt(_size2(column))[..., None].astype(a.dtype)


def line_log(
    p: Inexact[Array, "..."], q: Inexact[Array, "..."]
) -> Inexact[Array, "..."]:
    r"""Tangent at $p = zz^*$ of the shortest geodesic to $q = ww^*$, in the Frobenius
    metric: $\frac{2\theta}{\sin 2\theta} P_p q$ while the angle $\theta$ of the lines is
    below $\pi/4$. Beyond, to rounding up to and at a right angle, where it is one of
    several: $zt^* + tz^*$, t the initial velocity from z to w on the unit sphere, where
    the phase of w is that of the point closest to z."""
    gap = symmetric_part(q - p)
    chord2 = 2 * jnp.sum(gap.real**2 + gap.imag**2, axis=(-2, -1))[..., None, None]
    near = chord2 < RIGHT_ANGLE
    z, w = leading_vector(p), leading_vector(q)
    inner = jnp.sum(jnp.conj(z) * w, axis=-1, keepdims=True)
    cosine2 = inner.real**2 + inner.imag**2
    orthogonal = cosine2 == 0.0
    cosine = jnp.where(orthogonal, 0.0, jnp.sqrt(jnp.where(orthogonal, 1.0, cosine2)))
    phase = jnp.conj(inner) / jnp.where(orthogonal, 1.0, cosine).astype(inner.dtype)
    across = w * jnp.where(orthogonal, 1.0, phase) - cosine.astype(z.dtype) * z
    sine = jnp.sqrt(jnp.where(near[..., 0], 1.0, _size2(across)[..., None]))
    velocity = (jnp.arctan2(sine, cosine) / sine).astype(z.dtype) * across
    half = velocity[..., :, None] * jnp.conj(z)[..., None, :]
    factor = angle_over_sine(chord2).astype(gap.dtype)
    return jnp.where(near, factor * off_diagonal(p, gap), half + adjoint(half))


def _size2(z: Inexact[Array, "..."]) -> Float[Array, "..."]:
    return norm_squared(z.real) + norm_squared(z.imag)
