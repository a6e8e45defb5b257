"""Orthonormal frames of tangent and normal spaces."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._algebra.small import eigh
from .._base import AbstractManifold


def tangent_frames(source: AbstractManifold, points) -> np.ndarray:
    """Orthonormal frames (Q, s, m) of the tangent spaces at the flattened points."""
    batch = jnp.asarray(points).reshape(-1, *source.point_shape)
    return np.asarray(frames_at(source, batch))


def frames_at(
    source: AbstractManifold, points: Float[Array, "Q *point_shape"]
) -> Float[Array, "Q s m"]:
    """The same, of points, under `jit`: eigenvectors of the tangent projections."""
    s = math.prod(source.point_shape)
    axes = jnp.eye(s).reshape(s, *source.point_shape)
    project = lambda p: jax.vmap(lambda v: source.tangent_projection(p, v))(axes)
    projectors = jax.vmap(project)(points).reshape(-1, s, s)
    symmetric = 0.5 * (projectors + jnp.swapaxes(projectors, 1, 2))
    return eigh(symmetric)[1][:, :, s - source.dim :]


def complete_frames(frames: Float[Array, "K s m"]) -> Float[Array, "K s s"]:
    """Tangent frames followed by an orthonormal basis of the normal space."""
    normals = jnp.linalg.qr(frames, mode="complete")[0][:, :, frames.shape[-1] :]
    return jnp.concatenate([frames, normals], axis=-1)
