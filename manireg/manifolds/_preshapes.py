"""Landmarks in the plane without position and size: complex vectors, centred and of unit
length (Kendall's preshapes)."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex

from .._algebra.smooth import norm_squared
from ._arrays import Numbers, as_array, first_index
from ._membership import is_concrete


def helmert(k: int) -> np.ndarray:
    """Rows (-1, .., -1, j, 0, .., 0)/sqrt(j(j+1)), j = 1..k-1: orthonormal, each of sum
    zero."""
    j = np.arange(1, k)[:, None]
    column = np.arange(k)[None, :]
    rows = np.where(column < j, -1.0, np.where(column == j, j, 0.0))
    return rows / np.sqrt(j * (j + 1.0))


def preshapes(name: str, landmarks: Numbers) -> Complex[Array, "..."]:
    """`(..., k)`, centred and of unit size."""
    landmarks = as_array(f"PlanarShapes: `{name}`", landmarks)
    if landmarks.ndim < 2 or landmarks.shape[-1] != 2:
        raise ValueError(
            f"PlanarShapes: landmarks must have shape (..., k, 2), found "
            f"{landmarks.shape}."
        )
    # from one of them first: far from the origin the differences have more digits
    xy = landmarks - landmarks[..., :1, :]
    xy = xy - jnp.mean(xy, axis=-2, keepdims=True)
    size2 = norm_squared(xy, 2)
    if is_concrete(size2):
        shapeless = np.asarray(~(size2 > 0) | ~jnp.isfinite(size2))
        if shapeless.any():
            raise ValueError(
                f"PlanarShapes: `{name}` holds {shapeless.sum()} of {shapeless.size} "
                "configurations without a shape (all landmarks coincide, or one is NaN or "
                f"infinite; first at index {first_index(shapeless)}); leave them out."
            )
    return jax.lax.complex(xy[..., 0], xy[..., 1]) / jnp.sqrt(size2)[..., None]


def turned(z: Complex[Array, "..."], by: Complex[Array, "..."]) -> Array:
    """z times the phase of a number; where that is 0, as it is."""
    size = jnp.abs(by)
    return z * jnp.where(size > 0, by / jnp.where(size > 0, size, 1.0), 1.0)
