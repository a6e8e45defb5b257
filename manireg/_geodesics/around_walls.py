r"""Shortest paths over the triangles of a scan, round its walls.

Each edge is given a few points, and all points of a triangle are joined: the shortest path
in that graph comes as close to that over the triangles as the points are dense (Lanthier,
Maheshwari and Sack 2001). Points are put only where a path as short can pass, $d(p, x) +
d(x, q) \le (1 + \epsilon)\, d(p, q)$, a band that narrows as they become denser.
"""

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float
from scipy.sparse.csgraph import dijkstra

from ..manifolds import PointCloud
from .facets import Facets, facets
from .scan_graph import joined, path_to

BAND = 0.1  # share by which a path in the first graph may be too long
STAGES = ((1, 0.03), (3, 0.01), (7, 0.01))  # points of an edge; the same share after it
FEWER = 200_000  # triangles with which a stage does without the points of the next


class Path(NamedTuple):
    points: Float[np.ndarray, "n 3"]
    corner: Bool[np.ndarray, " n"]
    """Bends round a wall here."""


def path_around_walls(
    cloud: PointCloud, graph: sp.csr_array, p, q, first, last
) -> Path | None:
    """The path from p to q, of which the nodes `first` and `last` of `graph` are next;
    None where the triangles do not lead there."""
    detour = np.sum(dijkstra(graph, indices=[first, last]), axis=0)
    near = detour <= (1 + BAND) * detour[first]
    if cloud.triangles is None:
        around = near | (np.asarray(graph.astype(bool) @ near) > 0)
        scan = facets(cloud, around)
    else:
        scan = facets(cloud)
    (start, end), ends = scan.holding(np.stack([p, q]))
    kept = np.any(near[scan.triangles], axis=1)
    kept[[start, end]] = True
    points, index = np.zeros((0, 3)), np.zeros(0, int)
    for count, share in STAGES:
        some = np.flatnonzero(kept)
        if len(index) and len(some) * count > FEWER:
            break
        triangles = scan.triangles[some]
        at = np.searchsorted(some, [start, end])
        nodes, joints = _with_points_on_edges(scan, triangles, count)
        distance, before = _from_ends(nodes, joints, ends, at)
        if not np.isfinite(distance[0, -1]):
            return None
        index = path_to(before[0], len(nodes) + 1)
        points = np.concatenate([nodes, ends])[index]
        detour = distance.sum(axis=0)
        passed = np.min(detour[joints.of_triangle], axis=1)
        kept[some] = passed <= (1 + share) * distance[0, -1]
        kept[[start, end]] = True
    # p and q may be nodes themselves
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    long = steps > 1e-12 * steps.sum()
    new = np.concatenate([[True], long[1:] & long[:-1], [True]])
    points, index = points[new], index[new]
    rim = np.isin(index, scan.walls)
    return Path(points, rim & _pressed(scan, index, points, rim))


class _Joints(NamedTuple):
    rows: np.ndarray
    cols: np.ndarray
    of_triangle: np.ndarray


def _with_points_on_edges(scan: Facets, triangles, count: int):
    """All points, those on edges last, and which are joined; there are none on walls,
    since only the ends of walls are corners of shortest paths."""
    ends = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, edge = np.unique(ends, axis=0, return_inverse=True)
    edge = edge.reshape(-1, 3)
    P = len(scan.points)
    share = (np.arange(count) + 1.0) / (count + 1)
    a, b = scan.points[edges[:, 0]], scan.points[edges[:, 1]]
    on_edges = a[:, None] + share[:, None] * (b - a)[:, None]
    nodes = np.concatenate([scan.points, on_edges.reshape(-1, 3)])
    inner = P + count * edge[:, :, None] + np.arange(count)
    of_triangle = np.concatenate([triangles, inner.reshape(len(triangles), -1)], axis=1)
    # which of the three edges: a corner lies opposite the next edge
    side = np.append([-1, -2, -3], np.repeat(np.arange(3), count))
    i, j = np.triu_indices(3 + 3 * count, 1)
    opposite = {-1: 1, -2: 2, -3: 0}
    apart = np.array(
        [
            (x >= 0 and y >= 0 and x != y) or (x < 0 <= y and opposite[x] == y)
            for x, y in zip(side[i], side[j], strict=True)
        ]
    )
    rows, cols = of_triangle[:, i[apart]].ravel(), of_triangle[:, j[apart]].ravel()
    key = lambda pairs: pairs[:, 0] * P + pairs[:, 1]
    blocked = np.isin(key(edges), key(np.sort(scan.walls, axis=1)))
    free = np.append(np.ones(P, bool), np.repeat(~blocked, count))
    open = free[rows] & free[cols]
    rows = np.concatenate([rows[open], edges[:, 0]])
    cols = np.concatenate([cols[open], edges[:, 1]])
    return nodes, _Joints(rows, cols, of_triangle)


def _from_ends(nodes, joints: _Joints, ends, at):
    """Distances from p and from q, which become the last two nodes."""
    size = len(nodes) + 2
    rows, cols = [joints.rows], [joints.cols]
    for node, triangle in zip((size - 2, size - 1), at, strict=True):
        around = joints.of_triangle[triangle]
        rows.append(np.full(len(around), node))
        cols.append(around)
    if at[0] == at[1]:
        rows.append(np.array([size - 2]))
        cols.append(np.array([size - 1]))
    row, col = np.concatenate(rows), np.concatenate(cols)
    places = np.concatenate([nodes, ends])
    lengths = np.linalg.norm(places[row] - places[col], axis=1)
    graph = joined(size, row, col, lengths)
    return dijkstra(graph, indices=[size - 2, size - 1], return_predecessors=True)


def _pressed(scan: Facets, index, points, rim) -> Bool[np.ndarray, " n"]:
    """Whether the path bends to the side where there is no scan."""
    pressed = np.zeros(len(index), bool)
    for i in np.flatnonzero(rim[1:-1]) + 1:
        inwards = into_scan(scan, index[i])
        one, other = points[i] - points[i - 1], points[i + 1] - points[i]
        bend = other / np.linalg.norm(other) - one / np.linalg.norm(one)
        pressed[i] = bend @ inwards < 0
    return pressed


def into_scan(scan: Facets, vertex) -> Float[np.ndarray, " 3"]:
    """Mean direction of the triangles around a vertex, by their angles."""
    fan = scan.triangles[np.any(scan.triangles == vertex, axis=1)]
    others = fan[fan != vertex].reshape(-1, 2)
    sides = scan.points[others] - scan.points[vertex]
    sides /= np.linalg.norm(sides, axis=2, keepdims=True)
    cosine = np.clip(np.sum(sides[:, 0] * sides[:, 1], axis=1), -1, 1)
    middle = sides.sum(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    # the integral of the direction over the angle
    whole = np.sum(np.sin(np.arccos(cosine) / 2)[:, None] * middle, axis=0)
    return whole / max(np.linalg.norm(whole), 1e-300)
