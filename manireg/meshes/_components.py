"""Parts of a mesh that do not touch."""

import os

import numpy as np
import trimesh
from jaxtyping import Float, Int

from ._edges import connected
from ._mesh import as_mesh
from ._weld import Welded, weld


def components_of(welded: Welded) -> Int[np.ndarray, " T"]:
    """The component of each triangle, the largest in area first."""
    triangles = welded.triangles
    pairs = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    part = connected(pairs, len(welded.same))[triangles[:, 0]]
    _, part = np.unique(part, return_inverse=True)
    areas = np.bincount(part, areas_of(welded.x[triangles]))
    rank = np.zeros(len(areas), int)
    rank[np.argsort(-areas, kind="stable")] = np.arange(len(areas))
    return rank[part]


def areas_of(corners: Float[np.ndarray, "T 3 3"]) -> Float[np.ndarray, " T"]:
    a, b, c = np.moveaxis(corners, 1, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def restricted(welded: Welded, kept) -> Welded:
    """To the triangles `kept`."""
    return welded._replace(faces=welded.faces[kept], triangles=welded.triangles[kept])


def largest_component(mesh: trimesh.Trimesh | str | os.PathLike) -> trimesh.Trimesh:
    """The mesh (or the mesh in a file) without the triangles of all components but that of
    the largest area; all vertices stay, so their numbers do.

    **Example:**

    ```python
    ball = trimesh.creation.icosphere(subdivisions=2)
    two = ball + ball.copy().apply_scale(0.1).apply_translation([3, 0, 0])
    len(mr.meshes.largest_component(two).faces)  # 320
    ```
    """
    mesh = as_mesh(mesh)
    welded = weld(mesh)
    part = components_of(welded)
    inside = np.zeros(len(welded.same), bool)
    inside[welded.triangles[part == 0]] = True
    kept = np.all(inside[welded.same[mesh.faces]], axis=1)
    return trimesh.Trimesh(mesh.vertices, mesh.faces[kept], process=False)
