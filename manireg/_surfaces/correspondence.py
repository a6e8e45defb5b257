"""Which place of one surface belongs to which of another: near in position and normal."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from ..manifolds import PointCloud

NEIGHBOURS = 5  # of each point on the other surface, whose mean is its match
CLOSEST = 1e-5  # of the size: what is nearer weighs no more
FAR = 6.0  # standard deviations at which a match is as likely an outlier
ITERATIONS = 10  # of scale and weights, each from the other


class OrientedPoints(NamedTuple):
    """Of a surface."""

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    """Unit length."""
    on_edge: Bool[np.ndarray, " n"]
    """Where the surface ends."""

    def among(self, chosen: Int[np.ndarray, " m"] | slice) -> "OrientedPoints":
        return OrientedPoints(*(values[chosen] for values in self))


class Matches(NamedTuple):
    """Where points belong on the other surface."""

    points: Float[np.ndarray, "n 3"]
    weights: Float[np.ndarray, " n"]
    """Between 0, an outlier, and 1."""


def matches(
    ours: OrientedPoints, theirs: OrientedPoints, normal_length: float
) -> Matches:
    r"""The match of $x_i$ with normal $n_i$ is the mean of those $y_j$ that are among its
    `NEIGHBOURS` nearest, or that have it among theirs, with weights $d_{ij}^{-2}$, in

    $$d_{ij}^2 = |x_i - y_j|^2 + a^2 |n_i - n_j|^2, \qquad a = \texttt{normal\_length}.$$

    Closest points of one direction alone leave what sticks out of the other surface
    without a match; those of both pull it there (White et al. 2019, MeshMonk). But where
    the edge of `ours` is farther than 2 a from that of `theirs`, the $y_j$ nearest to it
    lie beyond it, and pull nothing.

    Weights are those of `inlier_weights`, times the share of the mean that is off the
    edge of `theirs` (none of less than half: what goes on beyond the edge has no match),
    times the mean agreement of normals, $(1 + n \cdot n') / 2$.
    """
    features = [
        np.hstack([s.points, normal_length * s.normals]) for s in (ours, theirs)
    ]
    size = float(np.linalg.norm(np.ptp(theirs.points, axis=0)))
    forth = _affinity(*features, least=CLOSEST * size)
    back = _affinity(
        *features[::-1],
        least=CLOSEST * size,
        without=_unpaired(ours, theirs, 2 * normal_length),
    )
    mixed = forth + csr_array(back.T)
    there = np.hstack([theirs.points, theirs.normals, theirs.on_edge[:, None]])
    there = (mixed @ there) / mixed.sum(axis=1)[:, None]
    points, normals, inside = there[:, :3], there[:, 3:6], 1 - there[:, 6]
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
    allowed = np.where(inside < 0.5, 0.0, inside)
    weights = inlier_weights(np.sum((points - ours.points) ** 2, axis=1), allowed)
    return Matches(points, weights * 0.5 * (1 + np.sum(ours.normals * normals, axis=1)))


def _unpaired(
    ours: OrientedPoints, theirs: OrientedPoints, reach: float
) -> Bool[np.ndarray, " n"]:
    """Points on the edge of `ours` that the edge of `theirs` is not near."""
    alone = ours.on_edge.copy()
    if np.any(alone) and np.any(theirs.on_edge):
        edge = KDTree(theirs.points[theirs.on_edge])
        alone[alone] = edge.query(ours.points[alone])[0] > reach
    return alone


def _affinity(queries, points, least: float, without=None) -> csr_array:
    """Of each query with its nearest points; of none whose nearest is one of `without`."""
    count = min(NEIGHBOURS, len(points))
    found = KDTree(points).query(queries, k=count, workers=-1)
    distance, near = (np.reshape(a, (len(queries), count)) for a in found)
    weight = 1 / np.maximum(distance, least) ** 2
    if without is not None:
        weight[without[near[:, 0]]] = 0
    entries = weight.ravel(), near.ravel(), np.arange(0, near.size + 1, count)
    return csr_array(entries, shape=(len(queries), len(points)))


def inlier_weights(
    squares: Float[np.ndarray, " n"], allowed: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    r"""Probability that a distance is one of a normal law and not an outlier, whose law
    is uniform, as likely as the normal one at `FAR` standard deviations:

    $$w_i = a_i\, \frac{p_i}{p_i + e^{-\kappa^2 / 2}}, \qquad
      p_i = e^{-d_i^2 / 2 \sigma^2}, \qquad \sigma^2 = \sum w_i d_i^2 / \sum w_i$$

    by iteration from $w_i = a_i$, the weights allowed: far ones are found as long as they
    are fewer than $1 / \kappa^2$ of all, the rest is for edges and normals to tell."""
    uniform = np.exp(-(FAR**2) / 2)
    weights = allowed
    for _ in range(ITERATIONS):
        variance = np.sum(weights * squares) / max(np.sum(weights), 1e-300)
        if variance == 0:
            return weights
        normal = np.exp(-squares / (2 * variance))
        weights = allowed * normal / (normal + uniform)
    return weights


def edge_points(
    triangles: Int[np.ndarray, "t 3"] | None, count: int
) -> Bool[np.ndarray, " n"]:
    """Which of so many points are on a side of one triangle only; without any, none."""
    on_edge = np.zeros(count, bool)
    if triangles is not None:
        sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        sides, times = np.unique(sides, axis=0, return_counts=True)
        on_edge[sides[times == 1]] = True
    return on_edge


def oriented(surface: PointCloud) -> OrientedPoints:
    points = np.asarray(surface.points)
    triangles = surface.triangles
    triangles = None if triangles is None else np.asarray(triangles)
    edge = edge_points(triangles, len(points))
    return OrientedPoints(points, np.asarray(surface.normals), edge)
