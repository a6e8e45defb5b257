"""Random folds, and the error on those held out. Ours and the baselines' are the same, so
that methods are compared by the same rules."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, PRNGKeyArray

from ..manifolds import AbstractManifold

FOLDS = 10  # unless there are fewer data


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
