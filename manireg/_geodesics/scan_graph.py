"""The graph of a scan: edges of its mesh or neighbours, and shortest paths in it."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from ..manifolds import PointCloud

NEIGHBOURS = {1: 4, 2: 12}  # by dimension


def scan_graph(cloud: PointCloud) -> sp.csr_array:
    """Lengths between points. On a mesh along its edges, and across them from corner to
    corner: no step leads over a wall, however thin."""
    points = np.asarray(cloud.points)
    if cloud.triangles is not None:
        return _of_mesh(points, np.asarray(cloud.triangles))
    return _of_neighbours(points, np.asarray(cloud.normals), NEIGHBOURS[cloud.dim])


def joined(size: int, rows, cols, lengths: np.ndarray) -> sp.csr_array:
    """A graph both ways; of edges given twice the shorter one."""
    low, high = np.minimum(rows, cols), np.maximum(rows, cols)
    order = np.lexsort((lengths, high, low))
    low, high, lengths = low[order], high[order], lengths[order]
    new = np.append(True, (np.diff(low) != 0) | (np.diff(high) != 0))
    # no entry is zero: that would be no edge
    lengths = np.maximum(lengths[new], np.finfo(float).tiny)
    graph = sp.csr_array((lengths, (low[new], high[new])), shape=(size, size))
    return sp.csr_array(graph + graph.T)


def paths(
    graph: sp.csr_array, first: Int[np.ndarray, " k"], last: Int[np.ndarray, " k"]
) -> list[Int[np.ndarray, " n"]]:
    """The nodes of a shortest path for each pair."""
    found = [np.zeros(0, int)] * len(first)
    for start in np.unique(first):
        distance, before = dijkstra(graph, indices=start, return_predecessors=True)
        for i in np.flatnonzero(first == start):
            if not np.isfinite(distance[last[i]]):
                raise ValueError(
                    f"p, q: no path leads from p to q of pair {i} between neighbours of "
                    f"the cloud ({np.isfinite(distance).sum()} of {len(distance)} points "
                    "hang together with p); take both from one component."
                )
            found[i] = path_to(before, last[i])
    return found


def path_to(before: Int[np.ndarray, " P"], node) -> Int[np.ndarray, " n"]:
    path = [node]
    while before[path[-1]] >= 0:
        path.append(before[path[-1]])
    return np.array(path[::-1])


def equal_steps(corners, segments: int) -> Float[np.ndarray, "points s"]:
    """A polygon at equal steps of its length."""
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
    times = np.linspace(0.0, arc[-1], segments + 1)
    return np.stack([np.interp(times, arc, column) for column in corners.T], axis=1)


def _of_mesh(points, triangles) -> sp.csr_array:
    ends = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    tip = triangles[:, [2, 0, 1]].ravel()
    a, b = ends.T
    along = np.linalg.norm(points[a] - points[b], axis=1)
    low, high = np.minimum(a, b), np.maximum(a, b)
    order = np.lexsort((high, low))
    twice = np.flatnonzero((np.diff(low[order]) == 0) & (np.diff(high[order]) == 0))
    one, other = order[twice], order[twice + 1]
    # by the middle of the edge: straight where the two triangles are a parallelogram
    middle = (points[a[one]] + points[b[one]]) / 2
    across = np.linalg.norm(points[tip[one]] - middle, axis=1)
    across += np.linalg.norm(points[tip[other]] - middle, axis=1)
    rows = np.concatenate([a, tip[one]])
    cols = np.concatenate([b, tip[other]])
    apart = rows != cols
    lengths = np.concatenate([along, across])
    return joined(len(points), rows[apart], cols[apart], lengths[apart])


def _of_neighbours(points, normals, neighbours: int) -> sp.csr_array:
    """Those on the same side of the surface."""
    tree = KDTree(points)
    found = tree.query(points, k=min(neighbours + 1, len(points)))
    distance, near = (np.asarray(a) for a in found)
    here = np.repeat(np.arange(len(points)), near.shape[1] - 1)
    there, length = near[:, 1:].ravel(), distance[:, 1:].ravel()
    same = np.sum(normals[here] * normals[there], axis=1) > 0
    return joined(len(points), here[same], there[same], length[same])
