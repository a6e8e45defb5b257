"""Triangles of a scan, and its walls: the edges at which it ends. Those of its mesh, or
where there are only points, Delaunay triangles of neighbours in tangent planes."""

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ..manifolds import PointCloud

NEIGHBOURS = 24  # of a point, among which it has its triangles
ROOM = 2.0  # largest circumradius, over the spacing: a gap of five spacings is empty
FEWEST = 12  # walls around a hole of a cloud; fewer are chance
JITTER = 1e-4  # of the spacing: decides between the diagonals of a square
NEAR = 8  # vertices and centroids next to a point, whose triangles may hold it


class Facets(NamedTuple):
    """Part of a scan or all of it."""

    points: Float[np.ndarray, "P 3"]
    triangles: Int[np.ndarray, "T 3"]
    walls: Int[np.ndarray, "W 2"]

    @property
    def normals(self) -> Float[np.ndarray, "T 3"]:
        doubled = self._doubled()
        return doubled / np.linalg.norm(doubled, axis=1, keepdims=True)

    @property
    def sizes(self) -> Float[np.ndarray, " T"]:
        return np.sqrt(np.linalg.norm(self._doubled(), axis=1))

    def _doubled(self):
        a, b, c = np.moveaxis(self.points[self.triangles], 1, 0)
        return np.cross(b - a, c - a)

    def holding(self, x) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
        """The triangle nearest to each of `x (k, 3)`, and its closest point."""
        corners = self.points[self.triangles]
        k = len(x)
        centroids = KDTree(corners.mean(axis=1))
        some = _nearest(centroids, x)[1]
        rows, found = [np.repeat(np.arange(k), some.shape[1])], [some.ravel()]
        # large triangles have their centroids far away
        used = np.unique(self.triangles)
        vertices = KDTree(self.points[used])
        close = used[_nearest(vertices, x)[1]]
        order = np.argsort(self.triangles.ravel(), kind="stable")
        ends = np.searchsorted(
            self.triangles.ravel()[order], np.arange(len(self.points) + 1)
        )
        count = ends[close + 1] - ends[close]
        within = np.arange(count.sum()) - np.repeat(
            np.cumsum(count) - count.ravel(), count.ravel()
        )
        found.append(order[np.repeat(ends[close].ravel(), count.ravel()) + within] // 3)
        rows.append(np.repeat(np.arange(k), count.sum(axis=1)))
        row, triangle = np.concatenate(rows), np.concatenate(found)
        closest = trimesh.triangles.closest_point(corners[triangle], x[row])
        distance = np.linalg.norm(closest - x[row], axis=1)
        order = np.lexsort((triangle, distance, row))
        best = order[np.searchsorted(row[order], np.arange(k))]
        return triangle[best], closest[best]


def _nearest(tree: KDTree, x, most: int = NEAR) -> tuple[np.ndarray, np.ndarray]:
    """Distances and indices `(k, most)`, or of all there are."""
    distance, near = tree.query(x, k=min(most, tree.n))
    return np.reshape(distance, (len(x), -1)), np.reshape(near, (len(x), -1))


def facets(cloud: PointCloud, near: Bool[np.ndarray, " P"] | None = None) -> Facets:
    """Of the whole mesh; of a cloud without triangles around the points `near`."""
    points = np.asarray(cloud.points)
    if cloud.triangles is None:
        where = np.arange(len(points)) if near is None else np.flatnonzero(near)
        return _of_cloud(points, np.asarray(cloud.normals), cloud.frames, where)
    triangles = np.asarray(cloud.triangles)
    return Facets(points, triangles, edges_in_one(triangles))


def edges_in_one(triangles) -> Int[np.ndarray, "W 2"]:
    """Edges with one triangle."""
    ends = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(ends, axis=0, return_counts=True)
    return edges[count == 1]


def _of_cloud(points, normals, frames, where) -> Facets:
    tree = KDTree(points)
    frames, parts, one_sided = np.asarray(frames), [], []
    inside, cut = np.isin(np.arange(len(points)), where), np.zeros(len(points), bool)
    random = np.random.default_rng(0).uniform(-1, 1, points.shape)
    for some in np.array_split(where, max(1, len(where) // 4000)):
        distance, near = _nearest(tree, points[some], NEIGHBOURS + 1)
        distance, near = distance[:, 1:], near[:, 1:]
        cut[some] = ~np.all(inside[near], axis=1)
        spacing = np.median(distance[:, :6], axis=1)
        offset = points[near] - points[some, None]
        offset = offset + JITTER * spacing[:, None, None] * (
            random[near] - random[some, None]
        )
        same = np.einsum("pks,ps->pk", normals[near], normals[some]) > 0
        u = np.einsum("pks,psm->pkm", offset, frames[some])
        rows, a, b = _delaunay(u, same, ROOM * spacing)
        fan = np.stack([some[rows], near[rows, a], near[rows, b]], axis=1)
        parts.append(fan)
        ends = np.concatenate([fan[:, [0, 1]], fan[:, [0, 2]]])
        edges, count = np.unique(ends, axis=0, return_counts=True)
        one_sided.append(edges[count == 1])
    triangles = np.concatenate(parts)
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    # a wall is one for both its ends: points may differ over the triangles between them
    ends = np.concatenate(one_sided)
    edges, count = np.unique(np.sort(ends, axis=1), axis=0, return_counts=True)
    walls = _without_chance(edges[count == 2], cut)
    return Facets(points, triangles[np.sort(first)], walls)


def _without_chance(walls, cut):
    """Without short chains, unless they go on outside of what is looked at."""
    ones, size = np.ones(len(walls)), len(cut)
    joined = sp.coo_array((ones, tuple(walls.T)), shape=(size, size))
    part = np.asarray(connected_components(joined, directed=False)[1])[walls[:, 0]]
    count = np.bincount(part, minlength=size)
    goes_on = np.bincount(part, np.any(cut[walls], axis=1), minlength=size) > 0
    return walls[((count >= FEWEST) | goes_on)[part]]


def _delaunay(u, same, room):
    """Delaunay triangles of the origin and neighbours `u (p, k, 2)`: which rows, and two
    of the neighbours."""
    i, j = np.triu_indices(u.shape[1], 1)
    square = np.sum(u**2, axis=2)
    a, b = u[:, i], u[:, j]
    det = 2 * (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
    flat = np.abs(det) <= 1e-9 * np.sqrt(square[:, i] * square[:, j])
    det = np.where(flat, 1.0, det)
    x = (square[:, i] * b[..., 1] - square[:, j] * a[..., 1]) / det
    y = (square[:, j] * a[..., 0] - square[:, i] * b[..., 0]) / det
    good = ~flat & (np.hypot(x, y) <= room[:, None]) & same[:, i] & same[:, j]
    # |c - u|^2 >= |c|^2 for all other neighbours
    beyond = square[:, None] - 2 * (x[..., None] * u[:, None, :, 0])
    beyond -= 2 * y[..., None] * u[:, None, :, 1]
    beyond[:, np.arange(len(i)), i] = beyond[:, np.arange(len(j)), j] = 0.0
    good &= np.all((beyond >= 0) | ~same[:, None], axis=2)
    rows, pair = np.nonzero(good)
    return rows, i[pair], j[pair]
