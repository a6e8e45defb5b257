"""Closest points of a cloud: on the patch of the nearest of its points."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxkd.tree
from jaxtyping import Array, Float, Int

from .._base import AbstractManifold
from .quadric_patch import QuadricPatch


def tree_of(points) -> tuple[Array, Array]:
    """Without jaxkd's named tuple, which cannot be pickled."""
    _, order, axes = jaxkd.build_tree(points)
    return order, axes


def nearest_point(
    points: Float[Array, "P s"],
    tree: tuple[Array, Array],
    search: Callable[[Array, Array], Array] | None,
    p: Float[Array, "... s"],
) -> Int[Array, "..."]:
    """Index of the nearest of `points`."""
    queries = jax.lax.stop_gradient(p.reshape(-1, p.shape[-1]))
    if search is not None:
        index = search(points, queries)
    else:
        of_points = jaxkd.tree.tree_type(points, *tree)
        index = jaxkd.query_neighbors(of_points, queries, k=1)[0][:, 0]
    return index.reshape(p.shape[:-1])


@eqx.filter_jit
def on_patches(cloud: AbstractManifold, function: Callable, *arguments: Array):
    """`function` of the patches of the points nearest to the first of `arguments`;
    compiled once a shape, as its iterations would recompile outside of `jit`."""
    s = arguments[0].shape[-1]
    shape = jnp.broadcast_shapes(*(a.shape for a in arguments))
    flat = [jnp.broadcast_to(a, shape).reshape(-1, s) for a in arguments]
    index = cloud.nearest(flat[0])
    assert index is not None
    patches = cloud.patches(index)
    result = jax.vmap(function)(patches, *flat)
    return result.reshape(*shape[:-1], *result.shape[1:])


def signed_distance(patch: QuadricPatch, p):
    return (p - patch.project(p)) @ patch.unit_normal(p)
