"""A mesh, or the file it is in."""

import os

import numpy as np
import trimesh

from ._read import read_mesh


def as_mesh(mesh) -> trimesh.Trimesh:
    if isinstance(mesh, str | os.PathLike):
        mesh = read_mesh(mesh)
    if not isinstance(mesh, trimesh.Trimesh):
        raise ValueError(
            f"mesh: expected a trimesh.Trimesh or a file, found {type(mesh).__name__}."
        )
    if not len(mesh.faces):
        raise ValueError(f"mesh: {mesh!r} holds no triangles.")
    beyond = (mesh.faces < 0) | (mesh.faces >= len(mesh.vertices))
    if np.any(beyond):
        triangle = np.flatnonzero(np.any(beyond, axis=1))[0]
        raise ValueError(
            f"mesh: triangle {triangle} has vertices {mesh.faces[triangle].tolist()}, but "
            f"there are {len(mesh.vertices)}, numbered from 0. Are they numbered from 1? "
            "Then take `mesh.faces - 1`."
        )
    return mesh
