"""Orthonormal frames of tangent and normal spaces."""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
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
    """The same, of points, under `jit`: eigenvectors of the metric, which where that is
    of the ambient space is the tangent projection."""
    s = math.prod(source.point_shape)
    axes = jnp.eye(s).reshape(s, *source.point_shape)

    def images(p):
        tangent = jax.vmap(lambda v: source.tangent_projection(p, v))(axes)
        return tangent, jax.vmap(lambda v: source.orthonormal(p, v))(tangent)

    tangent, orthonormal = (a.reshape(-1, s, s) for a in jax.vmap(images)(points))
    metric = orthonormal @ jnp.swapaxes(orthonormal, 1, 2)
    values, vectors = eigh(metric)
    values, vectors = values[:, None, s - source.dim :], vectors[:, :, s - source.dim :]
    return jnp.swapaxes(tangent, 1, 2) @ vectors / jnp.sqrt(values)


def coordinates(
    manifold: AbstractManifold,
    p: Float[Array, "..."],
    frame: Float[Array, "t n"],
    v: Float[Array, " t"],
) -> Float[Array, " n"]:
    """Of a vector tangent at p on N in an orthonormal frame there."""
    axes = orthonormal_columns(manifold, p, frame)
    return axes.T @ manifold.orthonormal(p, v.reshape(p.shape)).ravel()


def orthonormal_columns(
    manifold: AbstractManifold, p: Float[Array, "..."], vectors: Float[Array, "t n"]
) -> Float[Array, "t n"]:
    """`orthonormal` coordinates of flattened vectors tangent at p, columns."""
    image = lambda v: manifold.orthonormal(p, v.reshape(p.shape)).ravel()
    return jax.vmap(image, 1, 1)(vectors)


def metric_of_chart(
    manifold: AbstractManifold, embed: Callable[[Array], Array]
) -> Callable[[Array], Array]:
    """The metric of a manifold in the coordinates of a chart."""
    return Partial(_metric_in_chart, manifold, embed)


def _metric_in_chart(manifold, embed, u):
    p, columns = embed(u).reshape(manifold.point_shape), jax.jacfwd(embed)(u)
    vectors = orthonormal_columns(manifold, p, columns)
    return vectors.T @ vectors


def orthonormal_axes(
    manifold: AbstractManifold, points: np.ndarray, vectors: Float[np.ndarray, "Q t n"]
) -> Float[np.ndarray, "Q t n"]:
    """The same at many flattened points, on the host."""
    if manifold.isometric:
        return vectors
    batch = np.asarray(points).reshape(-1, *manifold.point_shape)
    return at_each(orthonormal_columns, manifold, batch, vectors)


def complete_frames(frames: Float[np.ndarray, "K s m"]) -> Float[np.ndarray, "K s s"]:
    """Tangent frames followed by an orthonormal basis of the normal space."""
    normals = np.linalg.qr(frames, mode="complete")[0][:, :, frames.shape[-1] :]
    return np.concatenate([frames, normals], axis=-1)
