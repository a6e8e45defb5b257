"""Cross-validation as `manireg.cross_validate` does it: the same folds for the same
key, the same score, grids widened where the best value sits on an edge."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from ..manifolds import AbstractManifold

GRID = 20
WIDENINGS = 2  # times a default grid may be extended past an edge


def training_sets(
    k: int, folds: int, key: PRNGKeyArray | None
) -> Bool[np.ndarray, "folds k"]:
    """Which data each fold is fitted to; `folds=k` leaves out one at a time."""
    if not 2 <= folds <= k:
        raise ValueError(
            f"folds: must lie between 2 and the number of data, {k}; found {folds}."
        )
    key = jax.random.key(0) if key is None else key
    fold_of = np.asarray(jax.random.permutation(key, k)) % folds
    return fold_of[None, :] != np.arange(folds)[:, None]


def held_out_score(
    target: AbstractManifold,
    predicted: Float[Array, "k t"],
    y: Float[Array, "k t"],
    weights: Float[Array, " k"],
    training: Bool[Array, " k"],
) -> Float[Array, ""]:
    """Weighted mean geodesic error on the data outside `training`."""
    points = (a.reshape(-1, *target.point_shape) for a in (predicted, y))
    held_out = weights * ~training
    errors = jnp.sqrt(target.squared_distance(*points))
    return jnp.sum(held_out * errors) / jnp.sum(held_out)


def widened_scores(
    grid: Float[Array, " grid"],
    scores_of: Callable[[Array], Float[Array, "folds more"]],
    widen: bool,
) -> tuple[Float[Array, " grid_"], Float[Array, "folds grid_"]]:
    """Scores of a grid; with `widen`, of one extended past its edge by a quarter of its
    range (in as many values) while the best mean score sits there, at most twice."""
    scores = scores_of(grid)
    n = len(grid)
    ratios = (grid[-1] / grid[0]) ** (0.25 * jnp.arange(1, n + 1) / n)
    for _ in range(WIDENINGS if widen else 0):
        best = int(jnp.argmin(jnp.mean(scores, axis=0)))
        if 0 < best < len(grid) - 1:
            break
        below = best == 0
        more = grid[0] / ratios[::-1] if below else grid[-1] * ratios
        pair = [(more, scores_of(more)), (grid, scores)]
        (a, left), (b, right) = pair if below else pair[::-1]
        grid, scores = jnp.concatenate([a, b]), jnp.concatenate([left, right], axis=1)
    return grid, scores


def best_of(grid: Float[Array, " grid"], scores: Float[Array, "folds grid"]) -> Array:
    return grid[jnp.argmin(jnp.mean(scores, axis=0))]
