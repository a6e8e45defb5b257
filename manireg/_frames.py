"""Orthonormal frames of tangent and normal spaces."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .manifolds import AbstractManifold


def tangent_frames(source: AbstractManifold, points) -> np.ndarray:
    """Orthonormal frames (Q, s, m) of the tangent spaces, from the tangent projections."""
    s = points.shape[1]
    axes = jnp.eye(s).reshape(s, *source.point_shape)
    project = lambda p: jax.vmap(lambda v: source.tangent_projection(p, v))(axes)
    batch = jnp.asarray(points).reshape(-1, *source.point_shape)
    projectors = np.asarray(jax.vmap(project)(batch)).reshape(-1, s, s)
    symmetric = 0.5 * (projectors + projectors.transpose(0, 2, 1))
    return np.linalg.eigh(symmetric)[1][:, :, -source.dim :]


def complete_frames(frames: Float[Array, "K s m"]) -> Float[Array, "K s s"]:
    """Tangent frames followed by an orthonormal basis of the normal space."""
    normals = jnp.linalg.qr(frames, mode="complete")[0][:, :, frames.shape[-1] :]
    return jnp.concatenate([frames, normals], axis=-1)
