"""Shortest paths along the edges between neighbours in a point cloud, on the host."""

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from .. import PointCloud

NEIGHBOURS = {1: 4, 2: 12}  # by dimension


def cloud_paths(
    cloud: PointCloud, p, q, segments: int
) -> Float[np.ndarray, "k points s"]:
    """A path for each pair of points `p (k, s)`, `q (k, s)`, cut into `segments` steps of
    equal length. A straight segment may land on the wrong sheet; a path stays on the
    surface, but is up to a tenth too long and has corners."""
    points, p, q = (np.asarray(a) for a in (cloud.points, p, q))
    tree = KDTree(points)
    graph = _graph(tree, np.asarray(cloud.normals), NEIGHBOURS[cloud.dim])
    first, last = (np.atleast_1d(tree.query(a)[1]) for a in (p, q))
    paths = np.zeros((len(p), segments + 1, points.shape[1]))
    for start in np.unique(first):
        distance, before = dijkstra(graph, indices=start, return_predecessors=True)
        for i in np.flatnonzero(first == start):
            if not np.isfinite(distance[last[i]]):
                raise ValueError(
                    f"p, q: no path leads from p to q of pair {i} between neighbours of "
                    f"the cloud ({np.isfinite(distance).sum()} of {len(points)} points "
                    "hang together with p); take both from one component."
                )
            node, path = last[i], []
            while node != start:
                path.append(node)
                node = before[node]
            # p and q take the place of the points next to them
            corners = np.stack([p[i], *points[path[:0:-1]], q[i]])
            paths[i] = _equal_steps(corners, segments)
    return paths


def _graph(tree: KDTree, normals, neighbours: int) -> sp.csr_array:
    """Distances of neighbours on the same side of the surface."""
    points = tree.data
    found = tree.query(points, k=min(neighbours + 1, len(points)))
    distance, near = (np.asarray(a) for a in found)
    here = np.repeat(np.arange(len(points)), near.shape[1] - 1)
    there, length = near[:, 1:].ravel(), distance[:, 1:].ravel()
    same = np.sum(normals[here] * normals[there], axis=1) > 0
    rows, cols = here[same], there[same]
    graph = sp.csr_array((length[same], (rows, cols)), shape=(len(points),) * 2)
    return sp.csr_array(graph.maximum(graph.T))


def _equal_steps(corners, segments: int):
    arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
    times = np.linspace(0.0, arc[-1], segments + 1)
    return np.stack([np.interp(times, arc, column) for column in corners.T], axis=1)
