"""Surfaces and landmarks as they are given, in the numbers of their mesh or file."""

from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import Float, Int

from .._sources.checks import check_landmarks
from ..manifolds import PointCloud
from ..meshes._files import numbers_vertices
from ..meshes._surface import as_mesh

Surface = trimesh.Trimesh | PointCloud | str | Path


class GivenSurface(NamedTuple):
    """A point cloud, and the mesh it was given by."""

    cloud: PointCloud
    """Without `of_vertex`: programs are shared whatever the mesh repeats or leaves out."""
    vertices: Float[np.ndarray, "n 3"]
    of_vertex: Int[np.ndarray, " n"]
    """The point of each vertex."""
    faces: Int[np.ndarray, "f 3"] | None
    numbered: bool


def given_surface(name: str, surface: Surface) -> GivenSurface:
    if isinstance(surface, PointCloud):
        points, numbers = np.asarray(surface.points), surface.of_vertex
        numbers = np.arange(len(points)) if numbers is None else np.asarray(numbers)
        return GivenSurface(_bare(surface), points[numbers], numbers, None, True)
    numbered = isinstance(surface, trimesh.Trimesh) or numbers_vertices(surface)
    try:
        mesh = as_mesh(surface)
        cloud = PointCloud.from_mesh(mesh)
    except ValueError as error:
        raise ValueError(str(error).replace("mesh:", f"{name}:", 1)) from error
    vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces)
    of_vertex = np.asarray(cloud.of_vertex)
    return GivenSurface(_bare(cloud), vertices, of_vertex, faces, numbered)


def _bare(cloud: PointCloud) -> PointCloud:
    is_none = lambda leaf: leaf is None
    return eqx.tree_at(lambda c: c.of_vertex, cloud, None, is_leaf=is_none)


def normals_at(cloud: PointCloud, points) -> Float[np.ndarray, "l 3"]:
    return np.asarray(cloud.normals[cloud.nearest(jnp.asarray(points))])


def landmark_positions(
    name: str, landmarks, surface: GivenSurface
) -> Float[np.ndarray, "l 3"]:
    """Landmarks as points of the surface."""
    landmarks, vertices = np.asarray(landmarks), surface.vertices
    if landmarks.ndim == 1 and landmarks.dtype.kind in "iu":
        if not surface.numbered:
            raise ValueError(
                f"{name}: vertex numbers, but STL files do not number vertices. Give "
                "positions (l, 3), or a mesh as PLY or OBJ."
            )
        wrong = landmarks[(landmarks < 0) | (landmarks >= len(vertices))]
        if len(wrong):
            raise ValueError(
                f"{name}: vertex {wrong[0]} does not exist; there are {len(vertices)}."
            )
        positions = vertices[landmarks]
    elif landmarks.ndim == 2 and landmarks.shape[1] == 3:
        positions = landmarks.astype(float)
    else:
        raise ValueError(
            f"{name}: expected vertex numbers (l,) or positions (l, 3), found shape "
            f"{landmarks.shape} of {landmarks.dtype}."
        )
    bad = np.flatnonzero(~np.all(np.isfinite(positions), axis=1))
    if len(bad):
        raise ValueError(
            f"{name}: NaN or infinity in {len(bad)} of {len(positions)} (first at index "
            f"{bad[0]}); remove these pairs."
        )
    return check_landmarks(name, surface.cloud, positions)
