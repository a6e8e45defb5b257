"""Which vertices of a mesh are one point of a surface, and which triangles are part of it.
Everything is relative to the size of the mesh."""

from typing import NamedTuple

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from ._edges import connected, open_edges, sides_of
from ._report import Finding, found

EQUAL = 1e-8  # of the size: vertices on open edges that are nearer are one point
THIN = 1e-8  # of the size: height of a degenerate triangle


class Welded(NamedTuple):
    x: Float[np.ndarray, "n 3"]
    """Vertices around the origin, in units of the size; at 0 those without a place."""
    placed: Bool[np.ndarray, " n"]
    """Whether a vertex has a place: no NaN."""
    centre: Float[np.ndarray, "3"]
    size: float
    same: Int[np.ndarray, " n"]
    """For each vertex the first one at its place."""
    faces: Int[np.ndarray, " T"]
    """The triangles kept: neither degenerate nor copies."""
    triangles: Int[np.ndarray, "T 3"]
    """Their corners, as entries of `same`."""
    findings: tuple[Finding, ...]


def weld(mesh: trimesh.Trimesh) -> Welded:
    """Vertices at one place are one point only where triangles end: at seams of a
    texture, say. Two sheets that touch inside stay two."""
    vertices, faces = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces)
    placed = np.all(np.isfinite(vertices), axis=1)
    whole = np.all(placed[faces], axis=1)
    if not np.any(whole):
        raise ValueError(
            f"mesh: all {len(faces)} triangles have vertices of NaN or infinity; is the "
            "file damaged?"
        )
    corners = vertices[faces[whole]]
    lower, upper = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    centre, size = lower + (upper - lower) / 2, float(np.max(upper - lower))
    if size == 0:
        raise ValueError(f"mesh: all {len(faces)} triangles are degenerate.")
    x = np.where(placed[:, None], (vertices - centre) / size, 0.0)
    sound = whole & (_heights(x, faces) > THIN)
    same = _same_places(x, np.unique(open_edges(sides_of(faces[sound]))))
    triangles = same[faces]
    sound &= _heights(x, triangles) > THIN
    if not np.any(sound):
        raise ValueError(f"mesh: all {len(faces)} triangles are degenerate.")
    kept = np.flatnonzero(sound)
    _, first = np.unique(np.sort(triangles[kept], axis=1), axis=0, return_index=True)
    unique = kept[np.sort(first)]
    findings = (
        found(
            "vertices of NaN or infinity",
            np.flatnonzero(~placed),
            "left out with their triangles; in results each goes with a neighbour",
            notable=True,
        )
        + found(
            "vertices at the place of another, where triangles end",
            np.flatnonzero(same != np.arange(len(same))),
            "taken as one point",
        )
        + found("degenerate triangles", np.flatnonzero(whole & ~sound), "left out")
        + found("copies of triangles", np.setdiff1d(kept, unique), "left out")
    )
    return Welded(
        x, placed, centre, size, same, unique, triangles[unique], tuple(findings)
    )


def _heights(x, triangles) -> Float[np.ndarray, " T"]:
    """Over the longest side."""
    a, b, c = np.moveaxis(x[triangles], 1, 0)
    longest = np.max([np.linalg.norm(e, axis=1) for e in (b - a, c - b, a - c)], axis=0)
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return doubled / np.where(longest > 0, longest, 1.0)


def _same_places(x, index) -> Int[np.ndarray, " n"]:
    """For each point the first of those of `index` at its place, for others itself."""
    same = np.arange(len(x))
    if len(index):
        group = places(x[index])
        _, first, inverse = np.unique(group, return_index=True, return_inverse=True)
        same[index] = index[first][inverse]
    return same


def places(x: Float[np.ndarray, "n s"]) -> Int[np.ndarray, " n"]:
    """A number for each point, the same for those nearer than `EQUAL`."""
    distinct, copy = np.unique(x, axis=0, return_inverse=True)
    pairs = KDTree(distinct).query_pairs(EQUAL, output_type="ndarray")
    return connected(pairs, len(distinct))[copy.ravel()]
