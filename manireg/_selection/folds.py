"""What every cross-validation here shares: folds, score, grids. Ours and the baselines'
use the same, so that methods are compared by the same rules."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, PRNGKeyArray

from ..manifolds import AbstractManifold

FOLDS = 10  # unless there are fewer data
GRID = 20  # values of a default grid
WIDENINGS = 2  # times it may be extended past an edge


def training_sets(
    weights: Float[ArrayLike, " k"], folds: int | None, key: PRNGKeyArray | None
) -> Bool[np.ndarray, "folds k"]:
    """Which data each random fold is fitted to; `folds=k` leaves out one at a time,
    default 10 or, of fewer data, k. Those of weight zero do not count: every fold is left
    with some to score."""
    heavy = np.asarray(weights) > 0
    k = int(np.sum(heavy))
    folds = min(FOLDS, k) if folds is None else folds
    if not 2 <= folds <= k:
        of_weight = "" if np.all(heavy) else " of positive weight"
        raise ValueError(
            f"folds: must lie between 2 and the number of data{of_weight}, {k}; found "
            f"{folds}."
        )
    key = jax.random.key(0) if key is None else key
    fold_of = np.zeros(len(heavy), dtype=int)
    fold_of[heavy] = np.asarray(jax.random.permutation(key, k)) % folds
    return fold_of[None, :] != np.arange(folds)[:, None]


def held_out_error(
    target: AbstractManifold,
    predicted: Float[Array, "k t"],
    y: Float[Array, "k t"],
    weights: Float[Array, " k"],
    training: Bool[Array, " k"],
) -> Float[Array, ""]:
    """Weighted mean geodesic error of points of N on the data outside `training`. Not
    squared: one datum in a gap, far off whatever lambda is, must not decide alone."""
    points = (a.reshape(-1, *target.point_shape) for a in (predicted, y))
    held_out = weights * ~training
    errors = jnp.sqrt(target.squared_distance(*points))
    return jnp.sum(held_out * errors) / jnp.sum(held_out)


def evaluated(
    grid: Float[Array, " n"], evaluate: Callable[[Array], Any], widen: bool
) -> tuple[Array, Any, int]:
    """`grid`, `evaluate(grid)` and the index of the best value.

    `evaluate` gives a tuple of arrays `(folds, n, ...)`, scores first. With `widen`, while
    the best mean score sits on an edge, the grid is extended past it by a quarter of its
    range (in as many values as before: compiled programs are used again), at most twice.
    """
    best_of = lambda results: _lowest(jnp.mean(results[0], axis=0))
    results = evaluate(grid)
    ratios = (grid[-1] / grid[0]) ** (0.25 * jnp.arange(1, len(grid) + 1) / len(grid))
    for _ in range(WIDENINGS if widen else 0):
        best = best_of(results)
        if 0 < best < len(grid) - 1:
            break
        below = best == 0
        new = grid[0] / ratios[::-1] if below else grid[-1] * ratios
        join = lambda old, new, axis: jnp.concatenate(
            [new, old] if below else [old, new], axis=axis
        )
        results = jax.tree.map(lambda a, b: join(a, b, 1), results, evaluate(new))
        grid = join(grid, new, 0)
    return grid, results, best_of(results)


def _lowest(scores: Float[Array, " n"]) -> int:
    """Of those that are numbers."""
    means = np.asarray(scores)
    if not np.any(np.isfinite(means)):
        raise ValueError(
            "cross-validation: no value of the grid has a finite score. Give a grid of "
            "your own, or a value."
        )
    return int(np.argmin(np.where(np.isnan(means), np.inf, means)))
