"""The surface a triangle mesh stands for: which vertices are one point of it, which
triangles meet, which side is out. Everything is relative to the size of the mesh."""

import os
from typing import NamedTuple

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ._files import read_mesh

EQUAL = 1e-8  # of the size: vertices on open edges that are nearer are one point
THIN = 1e-8  # of the size: height of a degenerate triangle


class MeshSurface(NamedTuple):
    """Points, normals and areas of a surface, and where each vertex of the mesh is."""

    points: Float[np.ndarray, "P 3"]
    normals: Float[np.ndarray, "P 3"]
    areas: Float[np.ndarray, " P"]
    """A third of the triangles around each point."""
    triangles: Int[np.ndarray, "T 3"]
    of_vertex: Int[np.ndarray, " n"]
    """The point each vertex of the mesh is; the nearest, where no triangle uses it."""


class _Welded(NamedTuple):
    x: Float[np.ndarray, "n 3"]
    """Vertices around the origin, in units of the size."""
    size: float
    same: Int[np.ndarray, " n"]
    """For each vertex the first one at its place."""
    faces: Int[np.ndarray, " T"]
    """The triangles kept: neither degenerate nor copies."""
    triangles: Int[np.ndarray, "T 3"]
    """Their corners, as entries of `same`."""


def mesh_surface(mesh) -> MeshSurface:
    """Of a mesh or a file; what `PointCloud.from_mesh` documents."""
    mesh = as_mesh(mesh)
    welded = _weld(mesh)
    flip = _against_the_others(welded.triangles)
    if np.any(flip):
        raise ValueError(
            f"mesh: neighbouring triangles are oriented differently ({np.sum(flip)} of "
            f"{len(flip)} against the others), so normals change sides. Turn them: "
            "`mesh = manireg.meshes.wound_alike(mesh)`."
        )
    sizes = np.bincount(_parts(welded)[welded.triangles[:, 0]])
    sizes = np.sort(sizes[sizes > 0])[::-1]
    if len(sizes) > 1:
        listed = ", ".join(map(str, sizes[:5])) + (", ..." if len(sizes) > 5 else "")
        raise ValueError(
            f"mesh: {len(sizes)} components that do not touch ({listed} triangles); a map "
            "is smooth on one. Keep the largest, with the vertex numbers as they are: "
            "`mesh = manireg.meshes.largest_component(mesh)`."
        )
    vertex, corners = np.unique(welded.triangles, return_inverse=True)
    triangles, x = corners.reshape(-1, 3), welded.x[vertex]
    normals, areas = _normals_and_areas(x, triangles)
    of_vertex = np.searchsorted(vertex, welded.same)
    stray = vertex[np.minimum(of_vertex, len(vertex) - 1)] != welded.same
    of_vertex[stray] = KDTree(x).query(welded.x[stray])[1]
    points = np.asarray(mesh.vertices, dtype=float)[vertex]
    return MeshSurface(points, normals, areas * welded.size**2, triangles, of_vertex)


def largest_component(mesh: trimesh.Trimesh | str | os.PathLike) -> trimesh.Trimesh:
    """The mesh (or the mesh in a file) without the triangles of its smaller components;
    all vertices stay, so their numbers do."""
    mesh = as_mesh(mesh)
    welded = _weld(mesh)
    part = _parts(welded)
    largest = np.bincount(part[welded.triangles[:, 0]]).argmax()
    kept = np.all(part[welded.same[mesh.faces]] == largest, axis=1)
    return trimesh.Trimesh(mesh.vertices, mesh.faces[kept], process=False)


def wound_alike(mesh: trimesh.Trimesh | str | os.PathLike) -> trimesh.Trimesh:
    """The mesh (or the mesh in a file) with the fewest triangles turned around that makes
    all neighbours agree on their side; vertices and triangles keep their numbers.

    **Raises** ValueError where that is impossible, as on a Moebius strip."""
    mesh = as_mesh(mesh)
    welded = _weld(mesh)
    faces = np.array(mesh.faces)
    turned = welded.faces[_against_the_others(welded.triangles)]
    faces[turned] = faces[turned, ::-1]
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def as_mesh(mesh) -> trimesh.Trimesh:
    """A mesh, or the file it is in."""
    if isinstance(mesh, str | os.PathLike):
        mesh = read_mesh(mesh)
    if not isinstance(mesh, trimesh.Trimesh):
        raise ValueError(
            f"mesh: expected a trimesh.Trimesh or a file, found {type(mesh).__name__}."
        )
    if not len(mesh.faces):
        raise ValueError(f"mesh: {mesh!r} holds no triangles.")
    bad = np.flatnonzero(~np.all(np.isfinite(mesh.vertices), axis=1))
    if len(bad):
        raise ValueError(
            f"mesh: {len(bad)} of {len(mesh.vertices)} vertices hold NaN or infinity "
            f"(first: {bad[0]}); remove them."
        )
    beyond = (mesh.faces < 0) | (mesh.faces >= len(mesh.vertices))
    if np.any(beyond):
        triangle = np.flatnonzero(np.any(beyond, axis=1))[0]
        raise ValueError(
            f"mesh: triangle {triangle} has vertices {mesh.faces[triangle].tolist()}, but "
            f"there are {len(mesh.vertices)}, numbered from 0."
        )
    return mesh


def _weld(mesh: trimesh.Trimesh) -> _Welded:
    """Vertices at one place are one point only where triangles end: at seams of a
    texture, say. Two sheets that touch inside stay two."""
    vertices, faces = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces)
    lower, upper = vertices[faces].min(axis=(0, 1)), vertices[faces].max(axis=(0, 1))
    size = float(np.max(upper - lower))
    if size == 0:
        raise ValueError(f"mesh: all {len(faces)} triangles are degenerate.")
    x = (vertices - (lower + (upper - lower) / 2)) / size
    sound = _heights(x, faces) > THIN
    same = _same_places(x, _ends(faces[sound]))
    triangles = same[faces]
    sound &= _heights(x, triangles) > THIN
    if not np.any(sound):
        raise ValueError(f"mesh: all {len(faces)} triangles are degenerate.")
    kept = np.flatnonzero(sound)
    _, first = np.unique(np.sort(triangles[kept], axis=1), axis=0, return_index=True)
    kept = kept[np.sort(first)]
    return _Welded(x, size, same, kept, triangles[kept])


def _heights(x, triangles) -> Float[np.ndarray, " T"]:
    """Over the longest side."""
    a, b, c = np.moveaxis(x[triangles], 1, 0)
    longest = np.max([np.linalg.norm(e, axis=1) for e in (b - a, c - b, a - c)], axis=0)
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return doubled / np.where(longest > 0, longest, 1.0)


def _sides(triangles) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Every side of a triangle, in the order of its ends: lower and upper end, triangle,
    whether it runs upwards."""
    start = triangles.ravel()
    end = np.roll(triangles, -1, axis=1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((high, low))
    owner = np.repeat(np.arange(len(triangles)), 3)
    return low[order], high[order], owner[order], (start < end)[order]


def _uses(low, high) -> tuple[np.ndarray, np.ndarray]:
    """For each edge the first of its sides, and how many there are."""
    new = np.append(True, (low[1:] != low[:-1]) | (high[1:] != high[:-1]))
    first = np.flatnonzero(new)
    return first, np.diff(np.append(first, len(low)))


def _ends(triangles) -> Int[np.ndarray, " e"]:
    """Vertices of edges with one triangle."""
    if not len(triangles):
        return np.zeros(0, int)
    low, high, _, _ = _sides(triangles)
    first, count = _uses(low, high)
    single = first[count == 1]
    return np.unique([low[single], high[single]])


def _same_places(x, index) -> Int[np.ndarray, " n"]:
    """For each point the first of those of `index` at its place, for others itself."""
    same = np.arange(len(x))
    if len(index):
        places, copy = np.unique(x[index], axis=0, return_inverse=True)
        pairs = KDTree(places).query_pairs(EQUAL, output_type="ndarray")
        group = _connected(pairs, len(places))[copy.ravel()]
        _, first, inverse = np.unique(group, return_index=True, return_inverse=True)
        same[index] = index[first][inverse]
    return same


def _connected(pairs, number: int) -> Int[np.ndarray, " number"]:
    """Component of each of `number` things that hang together in pairs."""
    graph = coo_array((np.ones(len(pairs), bool), pairs.T), shape=(number, number))
    return connected_components(graph, directed=False)[1]


def _parts(welded: _Welded) -> Int[np.ndarray, " n"]:
    """Component of each vertex."""
    triangles = welded.triangles
    pairs = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    return _connected(pairs, len(welded.same))


def _against_the_others(triangles) -> Bool[np.ndarray, " T"]:
    """The fewest triangles to turn around for neighbours to agree. Of each triangle there
    are two, as it is and turned; those that agree across an edge hang together."""
    T = len(triangles)
    low, high, owner, upwards = _sides(triangles)
    first, count = _uses(low, high)
    one = first[count == 2]
    a, b = owner[one], owner[one + 1]
    agree = upwards[one] != upwards[one + 1]
    pairs = np.concatenate(
        [
            np.stack([a, np.where(agree, b, b + T)], axis=1),
            np.stack([a + T, np.where(agree, b + T, b)], axis=1),
        ]
    )
    group = _connected(pairs, 2 * T)
    as_is, turned = group[:T], group[T:]
    if np.any(as_is == turned):
        raise ValueError(
            "mesh: the surface has one side only, like a Moebius strip (around triangle "
            f"{np.flatnonzero(as_is == turned)[0]}); cut it."
        )
    votes = np.bincount(as_is, minlength=2 * T)
    fewer, tied = votes[as_is] < votes[turned], votes[as_is] == votes[turned]
    return fewer | (tied & (as_is > turned))


def _normals_and_areas(x, triangles):
    """Normals are means over the angles around a point, or where triangles lie back to
    back and cancel that of one of them; not normalised."""
    corners = x[triangles]
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    doubled = np.cross(ahead[:, 0], back[:, 0])
    size = np.linalg.norm(doubled, axis=1)
    cosine = np.sum(ahead * back, axis=2)
    angle = np.arctan2(size[:, None], cosine)
    normal = doubled / size[:, None]
    share = angle[:, :, None] * normal[:, None]
    index, P = triangles.ravel(), len(x)
    sums = [np.bincount(index, s, minlength=P) for s in share.reshape(-1, 3).T]
    angles = np.bincount(index, angle.ravel(), minlength=P)
    areas = np.bincount(index, np.repeat(size / 6, 3), minlength=P)
    normals = np.stack(sums, axis=1) / angles[:, None]
    lost = np.linalg.norm(normals, axis=1) < 1e-6
    some = np.zeros(P, int)
    some[index] = np.repeat(np.arange(len(triangles)), 3)
    normals[lost] = normal[some[lost]]
    return normals, areas
