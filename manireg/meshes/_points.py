"""The surface that points without triangles stand for: which are one, which side is out.

Normals that are missing are those of the least spread among neighbours; their sides go
from neighbour to neighbour along a tree of those that are most nearly parallel (Hoppe,
DeRose, Duchamp, McDonald and Stuetzle 1992).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import (
    breadth_first_order,
    connected_components,
    minimum_spanning_tree,
)
from scipy.spatial import KDTree

from ._report import Finding, Report, found
from ._weld import places

NEIGHBOURS = 12  # of a point, which its normal is estimated from
CLOSED = 0.2  # mean cosine of normals and directions outwards that tells the side


class PointsSurface(NamedTuple):
    points: Float[np.ndarray, "P 3"]
    normals: Float[np.ndarray, "P 3"]
    of_vertex: Int[np.ndarray, " n"]
    """The point of each point given."""
    report: Report


def points_surface(points: np.ndarray, normals: np.ndarray | None) -> PointsSurface:
    """Of points `(n, 3)`, with normals of any length or without."""
    n, placed = len(points), np.all(np.isfinite(points), axis=1)
    at = np.flatnonzero(placed)
    lower, upper = points[at].min(axis=0), points[at].max(axis=0)
    extent = float(np.max(upper - lower))
    if extent == 0:
        raise ValueError(f"points: all {n} are at one place.")
    x = (points[at] - (lower + (upper - lower) / 2)) / extent
    group = places(x)
    _, first, copy = np.unique(group, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    kept = np.sort(first)
    of_vertex = np.zeros(n, int)
    of_vertex[at] = rank[copy.ravel()]
    findings = found(
        "points of NaN or infinity",
        np.flatnonzero(~placed),
        "left out; in results each goes with the first point",
        notable=True,
    )
    again = np.setdiff1d(at, at[kept])
    findings += found("points at the place of another", again, "taken as one point")
    x = x[kept]
    normals = None if normals is None else np.asarray(normals, float)[at[kept]]
    if normals is not None and np.any(lost := _lost(normals)):
        done = "all are estimated, the sides from those that are known"
        findings += found("normals without a direction", at[kept][lost], done, True)
        directed, _ = oriented_normals(x)
        known = np.where(lost[:, None], 0.0, normals)
        directed *= _sides_like(x, directed, known)[:, None]
        normals = np.where(lost[:, None], directed, normals)
    if normals is None:
        normals, sure = oriented_normals(x)
        findings.append(Finding("normals are missing", len(x), None, sure, True))
    report = Report(n, 0, extent, tuple(findings))
    return PointsSurface(points[at[kept]], normals, of_vertex, report)


def oriented_normals(
    x: Float[np.ndarray, "P 3"],
) -> tuple[Float[np.ndarray, "P 3"], str]:
    """Unit normals, all on one side, and in words how sure that is."""
    k = min(NEIGHBOURS, len(x) - 1)
    near = np.asarray(KDTree(x).query(x, k=k + 1)[1])
    patch = x[near] - x[near].mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("pki,pkj->pij", patch, patch))[1][:, :, 0]
    here, there = np.repeat(np.arange(len(x)), k), near[:, 1:].ravel()
    cosine = np.sum(normals[here] * normals[there], axis=1)
    # entries of 0 are no edges
    cost = 1 + 1e-9 - np.abs(cosine)
    graph = coo_array((cost, (here, there)), shape=(len(x),) * 2).tocsr()
    graph = graph.maximum(graph.T)
    tree = minimum_spanning_tree(graph)
    pieces, piece = connected_components(graph, directed=False)
    sign = np.ones(len(x))
    for number in range(pieces):
        start = np.argmax(piece == number)
        order, before = breadth_first_order(tree, start, directed=False)
        steps = np.sign(np.sum(normals[order[1:]] * normals[before[order[1:]]], axis=1))
        for node, step in zip(order[1:], steps):
            sign[node] = sign[before[node]] * (step or 1.0)
    normals = normals * sign[:, None]
    outwards = []
    for number in range(pieces):
        own = piece == number
        away = x[own] - x[own].mean(axis=0)
        length = np.linalg.norm(away, axis=1)
        share = np.sum(away * normals[own]) / np.sum(length)
        normals[own] *= np.sign(share) or 1.0
        outwards.append(abs(share))
    agree = np.mean(np.sum(normals[here] * normals[there], axis=1) > 0)
    side = "pointing outwards"
    if min(outwards) < CLOSED:
        side = "but which side is out is a guess, as the surface is open"
    parts = f", in {pieces} parts each for itself" if pieces > 1 else ""
    sure = f"{100 * agree:.4g} % of neighbours agree on a side{parts}"
    return normals, f"estimated from {k} neighbours; {sure}, {side}"


def _lost(normals) -> np.ndarray:
    length = np.linalg.norm(normals, axis=1)
    return ~(length > 1e-12 * np.nanmax(length, initial=0.0))


def _sides_like(x, normals, known) -> np.ndarray:
    """1 or -1 for each of `normals`, to be on the side of those `known` nearby."""
    there = np.flatnonzero(np.any(known != 0, axis=1))
    if not len(there):
        return np.ones(len(x))
    nearest = there[KDTree(x[there]).query(x)[1]]
    side = np.sum(normals[nearest] * known[nearest], axis=1)
    side *= np.sign(np.sum(normals * normals[nearest], axis=1))
    return np.where(side < 0, -1.0, 1.0)
