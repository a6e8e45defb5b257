"""Quasi-uniform or graded subsets: each point the farthest from those before it."""

import numpy as np
from scipy.spatial import KDTree
from scipy.special import gamma

NEIGHBOURS = 8  # in a local spacing


def farthest_points(cloud: np.ndarray, n: int) -> np.ndarray:
    """`n` points of `cloud`, each the farthest from those before it."""
    return cloud[farthest_indices(cloud, n)]


def farthest_indices(
    cloud: np.ndarray, n: int, first=(), spacing: np.ndarray | float = 1.0
) -> np.ndarray:
    """Indices of the distinct points `first` (default: point 0) and then, up to `n`, of
    the points of `cloud` that are farthest from all before, in units of `spacing`."""
    first = np.unique(np.asarray(first, dtype=int)) if len(first) else np.zeros(1, int)
    chosen = np.append(first, np.zeros(max(0, n - len(first)), dtype=int))
    distance = np.full(len(cloud), np.inf)
    scale = np.broadcast_to(np.asarray(spacing), len(cloud)) ** -2.0
    for i, new in enumerate(chosen):
        if i >= len(first):
            chosen[i] = new = np.argmax(distance * scale)
        offset = cloud - cloud[new]
        distance = np.minimum(distance, np.einsum("ps,ps->p", offset, offset))
    return chosen


def graded_spacing(points: np.ndarray, data: np.ndarray) -> np.ndarray:
    """Relative spacing of a sampling that is dense near data: 1 + d/D, d the distance to
    the nearest datum, D the mean distance of a datum to its own nearest."""
    data = np.unique(np.asarray(data), axis=0)
    apart = np.mean(KDTree(data).query(data, k=2)[0][:, 1])
    return 1 + KDTree(data).query(points)[0] / apart


def local_spacings(points: np.ndarray, m: int) -> np.ndarray:
    """Spacing h of m-dimensional samples around each of them: the ball that holds the
    eight nearest has eight times the volume h^m."""
    neighbours = min(NEIGHBOURS, len(points) - 1)
    radius = KDTree(points).query(points, k=neighbours + 1)[0][:, -1]
    unit_ball = np.pi ** (m / 2) / gamma(m / 2 + 1)
    return radius * (unit_ball / neighbours) ** (1 / m)
