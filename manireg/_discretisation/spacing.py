"""Quasi-uniform or graded subsets: each point the farthest from those before it."""

import numpy as np
from scipy.spatial import KDTree
from scipy.special import gamma

NEIGHBOURS = 8  # in a local spacing
SHARERS = 8  # points that are nearest to one at the same time, at most
EQUAL = 1e-12  # squared distances that differ by a smaller share are equal


def farthest_points(cloud: np.ndarray, n: int) -> np.ndarray:
    """`n` points of `cloud`, each the farthest from those before it."""
    return cloud[farthest_indices(cloud, n)]


def farthest_indices(
    cloud: np.ndarray,
    n: int,
    first=(),
    spacing: np.ndarray | float = 1.0,
    growth: float | None = None,
) -> np.ndarray:
    """Indices of the distinct points `first` (default: point 0) and then, up to `n`, of
    the points of `cloud` that are farthest from all before, in units of `spacing`, which
    grows by at most `growth` per distance (knowing that saves time). Of points equally far
    but for rounding the first is taken, so that neither unit nor origin matters."""
    first = np.unique(np.asarray(first, dtype=int)) if len(first) else np.zeros(1, int)
    chosen = np.append(first, np.zeros(max(0, n - len(first)), dtype=int))
    scale = np.broadcast_to(np.asarray(spacing), len(cloud)) ** -2.0
    nearest = first[KDTree(cloud[first]).query(cloud)[1]]
    distance = np.sum((cloud - cloud[nearest]) ** 2, axis=1)
    score, tree = distance * scale, KDTree(cloud)
    noise = rounding(cloud)
    for i in range(len(first), len(chosen)):
        new = np.argmax(score)
        share = EQUAL + 2 * noise / np.sqrt(max(distance[new], noise**2))
        chosen[i] = new = np.argmax(score >= (1 - share) * score[new])
        # no point farther from `new` than this can have it as its nearest
        reach = np.sqrt(distance[new])
        if np.ndim(spacing):
            slack = 0.0 if growth is None else 1 - growth * np.sqrt(score[new])
            reach = reach / slack if slack > 0 else np.sqrt(np.max(distance))
        near = tree.query_ball_point(cloud[new], reach * (1 + 1e-9) + noise)
        closer = np.minimum(distance[near], np.sum((cloud[near] - cloud[new]) ** 2, 1))
        distance[near], score[near] = closer, closer * scale[near]
    return chosen


def equally_near(points: np.ndarray, queries: np.ndarray) -> tuple:
    """Of each query the nearest few points, `(Q, k)`, and which of them are as near as the
    nearest, but for rounding."""
    distance, near = KDTree(points).query(queries, k=min(SHARERS, len(points)))
    distance, near = (a.reshape(len(queries), -1) for a in (distance, near))
    return near, distance <= distance[:, :1] * (1 + 1e-9) + rounding(points)


def rounding(points: np.ndarray) -> float:
    """Of distances between points: of their coordinates, which may lie far out."""
    return 8 * np.finfo(float).eps * float(np.max(np.abs(points), initial=0.0))


def data_spacings(points: np.ndarray, data: np.ndarray) -> np.ndarray:
    """Spacing of the data around each point: D + d, d the distance to the nearest datum,
    D the mean distance of a datum to its own nearest."""
    data = np.unique(np.asarray(data), axis=0)
    apart = np.mean(KDTree(data).query(data, k=2)[0][:, 1])
    return apart + KDTree(data).query(points)[0]


def local_spacings(points: np.ndarray, m: int) -> np.ndarray:
    """Spacing h of m-dimensional samples around each of them: the ball that holds the
    eight nearest has eight times the volume h^m."""
    neighbours = min(NEIGHBOURS, len(points) - 1)
    radius = KDTree(points).query(points, k=neighbours + 1)[0][:, -1]
    return ball_spacings(radius, neighbours, m)


def ball_spacings(radius: np.ndarray, inside: int, m: int) -> np.ndarray:
    """h, where `inside` points have the volume of a ball of that radius, h^m each."""
    unit_ball = np.pi ** (m / 2) / gamma(m / 2 + 1)
    return radius * (unit_ball / inside) ** (1 / m)
