"""Lines through 0, as their orthogonal projectors z z^T."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._algebra.smooth import RIGHT_ANGLE, angle_over_sine, norm_squared
from .matrix_functions import off_diagonal, symmetric_part


def leading_vector(a: Float[Array, "..."]) -> Float[Array, "..."]:
    """The unit vector z, up to its sign, of the matrix c z z^T, c > 0."""
    diagonal = jnp.diagonal(a, axis1=-2, axis2=-1)
    longest = jnp.argmax(diagonal, axis=-1)[..., None, None]
    column = jnp.take_along_axis(a, longest, axis=-1)[..., 0]
    return column / jnp.sqrt(norm_squared(column))[..., None]


def line_log(p: Float[Array, "..."], q: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""Tangent at $p = zz^T$ of the shortest geodesic to $q = ww^T$, in the Frobenius
    metric: $\frac{2\theta}{\sin 2\theta} P_p q$ while the angle $\theta$ of the lines is
    below $\pi/4$. Beyond, to rounding up to and at a right angle, where it is one of
    several: $zt^T + tz^T$, t the initial velocity from z to $\pm w$ on the unit
    sphere, whichever is closer."""
    gap = symmetric_part(q - p)
    chord2 = 2 * norm_squared(gap, 2)[..., None, None]
    near = chord2 < RIGHT_ANGLE
    z, w = leading_vector(p), leading_vector(q)
    inner = jnp.sum(z * w, axis=-1, keepdims=True)
    w, cosine = jnp.where(inner < 0.0, -w, w), jnp.abs(inner)
    across = w - cosine * z
    sine = jnp.sqrt(jnp.where(near[..., 0], 1.0, norm_squared(across)[..., None]))
    velocity = jnp.arctan2(sine, cosine) / sine * across
    half = velocity[..., :, None] * z[..., None, :]
    return jnp.where(
        near, angle_over_sine(chord2) * off_diagonal(p, gap), half + half.mT
    )
