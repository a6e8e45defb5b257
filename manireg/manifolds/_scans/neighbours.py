"""Which points lie next to each other on a surface."""

import numpy as np
import scipy.sparse as sp
from scipy.spatial import KDTree

HUB = 50  # neighbours of a vertex through which no ring goes on
EQUAL = 1e-6  # distances that differ by a smaller share are equal: the lower index wins
WIDER = 3  # times as many neighbours are looked at where sheets are close


def cloud_neighbours(points, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices and distances `(P, k)` of the nearest, in order."""
    return _nearest(KDTree(points), points, k)


def _nearest(tree: KDTree, points, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Of some points of the tree."""
    found = tree.query(points, k=min(k + 9, tree.n))
    distance, near = (np.asarray(a)[:, 1:] for a in found)  # without the point itself
    order = np.lexsort((near, _ranks(distance)), axis=1)[:, :k]
    take = lambda a: np.take_along_axis(a, order, axis=1)
    return take(near), take(distance)


def same_side_first(points, normals, near, distance) -> tuple[np.ndarray, np.ndarray]:
    """`cloud_neighbours`, where some are of another sheet with others in their place: the
    nearest of `WIDER` times as many whose normals agree, then the nearest of the rest."""
    agree = np.einsum("pks,ps->pk", normals[near], normals) > 0
    mixed = np.flatnonzero(~np.all(agree, axis=1))
    if not len(mixed):
        return near, distance
    near, distance, k = near.copy(), distance.copy(), near.shape[1]
    tree = KDTree(points)
    for chunk in np.array_split(mixed, 1 + len(mixed) // 20_000):
        more, far = _nearest(tree, points[chunk], min(WIDER * k, len(points) - 1))
        other = np.einsum("pks,ps->pk", normals[more], normals[chunk]) <= 0
        first = np.argsort(other, axis=1, kind="stable")[:, :k]
        near[chunk] = np.take_along_axis(more, first, axis=1)
        distance[chunk] = np.take_along_axis(far, first, axis=1)
    return near, distance


def mesh_neighbours(points, normals, triangles, k: int) -> np.ndarray:
    """Indices `(P, k)` of the nearest of those a few edges away, first those on the same
    side; where there are too few, the point itself fills the row."""
    P, start, end = len(points), triangles, np.roll(triangles, 1, axis=1)
    ends = np.concatenate([start, end]).ravel(), np.concatenate([end, start]).ravel()
    edges = sp.csr_array((np.ones(len(ends[0]), bool), ends), shape=(P, P))
    few = (np.diff(edges.indptr) <= HUB).astype(bool)
    onwards = sp.csr_array(edges.multiply(few[:, None]))
    reach, ring = edges, 1
    while 3 * ring * (ring + 1) < 2 * k:  # points within so many rings, mostly
        reach, ring = sp.csr_array(reach + reach @ onwards), ring + 1
    reach.setdiag(False)
    reach.eliminate_zeros()
    reach.sort_indices()
    count = np.diff(reach.indptr)
    rows, cols = np.repeat(np.arange(P), count), reach.indices
    rank = _ranks(np.linalg.norm(points[cols] - points[rows], axis=1))
    rank += (np.einsum("es,es->e", normals[rows], normals[cols]) <= 0) * (
        np.ptp(rank) + 1
    )
    order = np.argsort(rows * (np.ptp(rank) + 1) + rank - rank.min(), kind="stable")
    place = np.arange(len(rows)) - np.repeat(reach.indptr[:-1], count)
    near = np.repeat(np.arange(P)[:, None], k, axis=1)
    near[rows[place < k], place[place < k]] = cols[order][place < k]
    return near


def _ranks(distance) -> np.ndarray:
    """Whole numbers in the order of distances, up to a constant the same after a change of
    unit or origin."""
    least = np.finfo(float).tiny
    return np.round(np.log(np.maximum(distance, least)) / EQUAL).astype(int)
