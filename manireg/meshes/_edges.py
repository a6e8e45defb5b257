"""Sides of triangles, the edges they meet at, and what hangs together by them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


class Sides(NamedTuple):
    """Every side of a triangle, in the order of its ends."""

    low: Int[np.ndarray, " n"]
    high: Int[np.ndarray, " n"]
    triangle: Int[np.ndarray, " n"]
    upwards: Bool[np.ndarray, " n"]
    """Whether the triangle runs along it from the lower to the higher end."""
    first: Int[np.ndarray, " e"]
    """For each edge the first of its sides,"""
    uses: Int[np.ndarray, " e"]
    """and how many there are."""


def sides_of(triangles: Int[np.ndarray, "T 3"]) -> Sides:
    start = triangles.ravel()
    end = np.roll(triangles, -1, axis=1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((high, low))
    owner = np.repeat(np.arange(len(triangles)), 3)
    low, high = low[order], high[order]
    new = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    first = np.flatnonzero(np.append(len(low) > 0, new)[: len(low)])
    count = np.diff(np.append(first, len(low)))
    return Sides(low, high, owner[order], (start < end)[order], first, count)


def open_edges(sides: Sides) -> Int[np.ndarray, "e 2"]:
    """Ends of the edges with one triangle."""
    single = sides.first[sides.uses == 1]
    return np.stack([sides.low[single], sides.high[single]], axis=1)


def crowded_edges(sides: Sides) -> Int[np.ndarray, "e 2"]:
    """Ends of the edges with three triangles or more."""
    many = sides.first[sides.uses > 2]
    return np.stack([sides.low[many], sides.high[many]], axis=1)


def shared_edges(
    sides: Sides,
) -> tuple[Int[np.ndarray, " e"], Int[np.ndarray, "e 2"], Bool[np.ndarray, " e"]]:
    """Of the edges with two triangles: their first side, the triangles, and whether these
    are wound alike."""
    one = sides.first[sides.uses == 2]
    pair = np.stack([sides.triangle[one], sides.triangle[one + 1]], axis=1)
    return one, pair, sides.upwards[one] != sides.upwards[one + 1]


def connected(pairs, number: int) -> Int[np.ndarray, " number"]:
    """Component of each of `number` things that hang together in pairs."""
    graph = coo_array((np.ones(len(pairs), bool), pairs.T), shape=(number, number))
    return connected_components(graph, directed=False)[1]
