"""Cells of a source that is covered by charts, halved until none is larger than a spacing
that varies from place to place: centres and quadrature that follow the data."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from .._programs.sizes import at_each, bucket
from .._source import Atlas
from .quadrature import Sample, in_charts, to_second_order

Spacing = Callable[[Float[np.ndarray, "n s"]], Float[np.ndarray, " n"]]
FINER = 4  # cells a spacing that it is integrated over
MIDPOINT = np.zeros(1), np.ones(1)


class Cells(NamedTuple):
    """Boxes of coordinates, each in one of the charts of an atlas."""

    chart: Int[np.ndarray, " n"]
    lower: Float[np.ndarray, "n m"]
    upper: Float[np.ndarray, "n m"]


def graded_cells(atlas: Atlas, spacing: Spacing, most: float = np.inf) -> Cells | None:
    r"""Halved across their longest edge until it is no longer than $\sqrt2$ times the
    spacing at the middle, so that their volumes are $h^m$ on average. None if that takes
    more than `most`."""
    cells = Cells(np.arange(len(atlas.lower)), atlas.lower, atlas.upper)
    done, count = [], 0
    while len(cells.chart):
        coordinates = _coordinates(atlas, cells, MIDPOINT)
        points, jacobian, _ = at_each(to_second_order, atlas.embed, *coordinates)
        edges = np.linalg.norm(jacobian, axis=1) * (cells.upper - cells.lower)
        large = np.max(edges, axis=1) > np.sqrt(2) * spacing(points)
        done.append(jax.tree.map(lambda a, keep=~large: a[keep], cells))
        count += len(done[-1].chart)
        if count + np.sum(large) > most:
            return None
        cells = _halved(
            jax.tree.map(lambda a, keep=large: a[keep], cells),
            np.argmax(edges[large], axis=1),
        )
    return jax.tree.map(lambda *a: np.concatenate(a), *done)


def even_cells(atlas: Atlas, spacing: Spacing, most: float = np.inf) -> Cells | None:
    """On a curve with one chart: the lengths themselves follow the spacing, h each; so
    neighbours are about as long as each other."""
    fine = graded_cells(atlas, lambda x: spacing(x) / FINER, FINER * 2 * most)
    if fine is None:
        return None
    order = np.argsort(fine.lower[:, 0])
    points, _, _, lengths, _ = on_cells(atlas, fine)
    passed = np.append(0.0, np.cumsum((lengths / spacing(np.asarray(points)))[order]))
    n = bucket(max(3, round(passed[-1])))
    if n > most:
        return None
    ends = np.append(fine.lower[order, 0], fine.upper[order[-1], 0])
    ends = np.interp(np.linspace(0, passed[-1], n + 1), passed, ends)[:, None]
    return Cells(np.zeros(n, dtype=int), ends[:-1], ends[1:])


def _halved(cells: Cells, axis: Int[np.ndarray, " n"]) -> Cells:
    row = np.arange(len(axis))
    middle = 0.5 * (cells.lower[row, axis] + cells.upper[row, axis])
    lower, upper = cells.lower.copy(), cells.upper.copy()
    lower[row, axis], upper[row, axis] = middle, middle
    return Cells(
        np.tile(cells.chart, 2),
        np.concatenate([cells.lower, lower]),
        np.concatenate([upper, cells.upper]),
    )


def on_cells(atlas: Atlas, cells: Cells, rule=MIDPOINT, order: int = 2) -> Sample:
    """The product of a rule `(nodes, weights)` on [-1, 1], mean 1, in every cell."""
    coordinates = _coordinates(atlas, cells, rule)
    points, frames, forms, volume, higher = in_charts(atlas, order, *coordinates)
    m = cells.lower.shape[1]
    weights = np.prod(np.stack(np.meshgrid(*[rule[1]] * m, indexing="ij")), axis=0)
    boxes = np.prod(cells.upper - cells.lower, axis=1)[:, None]
    weights = volume * (boxes * weights.ravel()).ravel()
    return points, frames, forms, weights, higher


def _coordinates(atlas: Atlas, cells: Cells, rule) -> tuple[np.ndarray, np.ndarray]:
    """Of the nodes of the rule, and the labels of their charts."""
    m = cells.lower.shape[1]
    nodes = np.stack(np.meshgrid(*[rule[0]] * m, indexing="ij"), -1).reshape(-1, m)
    half = 0.5 * (cells.upper - cells.lower)[:, None]
    u = 0.5 * (cells.lower + cells.upper)[:, None] + half * nodes
    labels = np.repeat(atlas.labels[cells.chart], len(nodes), axis=0)
    return u.reshape(-1, m), labels
