"""Orthonormal frames of tangent and normal spaces."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._algebra.small import eigh
from ..._programs.sizes import at_each
from .._base import AbstractManifold


def tangent_frames(source: AbstractManifold, points) -> np.ndarray:
    """Orthonormal frames (Q, s, m) of the tangent spaces at the flattened points."""
    batch = np.asarray(points).reshape(-1, *source.point_shape)
    return at_each(_frame_at, source, batch)


def _frame_at(source: AbstractManifold, p: Float[Array, "..."]) -> Float[Array, "s m"]:
    return frames_at(source, p[None])[0]


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


def complete_frames(frames: Float[np.ndarray, "K s m"]) -> Float[np.ndarray, "K s s"]:
    """Tangent frames followed by an orthonormal basis of the normal space."""
    normals = np.linalg.qr(frames, mode="complete")[0][:, :, frames.shape[-1] :]
    return np.concatenate([frames, normals], axis=-1)
