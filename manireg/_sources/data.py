"""The data of a regression: pairs, their weights, and whether they are enough."""

import warnings

import jax
import numpy as np
from jaxtyping import Array

from .._input.numbers import as_numbers
from .._input.shown import shown
from .._source import AbstractSource
from ..manifolds import AbstractManifold
from .checks import check_points, check_source, check_target, projected
from .orders import least_inputs


def check_data(
    source: AbstractSource, target: AbstractManifold, x, y, weights, order: int = 2
) -> tuple[Array, Array, Array]:
    """Ambient coordinates of `x (k, s)` and of `y (k, t)` projected onto the target,
    `weights (k,)`; enough of them for an energy of that order."""
    check_target(target)
    check_source(source)
    x = check_points("x", source, x)
    y = check_points("y", target, y, count=len(x))
    weights = _checked_weights(weights, len(x))
    check_distinct(source, x, weights, least_inputs(source, order), f"order {order}")
    y = projected(target, y.reshape(-1, *target.point_shape))
    if text := target.doubt(np.asarray(y)):
        warnings.warn(f"y: {text}", stacklevel=3)
    # copies: the arrays of the user may change
    y = np.asarray(y).reshape(len(x), -1)
    return jax.device_put((np.array(x), np.array(y), np.array(weights)))


class TooFewInputs(ValueError):
    """For an order, which another may not need."""


def check_distinct(source: AbstractSource, x, weights, least: int, purpose: str):
    heavy = np.asarray(weights) > 0
    distinct = len(np.unique(np.asarray(x)[heavy], axis=0))
    if distinct < least:
        of_weight = "" if np.all(heavy) else " of positive weight"
        raise TooFewInputs(
            f"x: {distinct} distinct inputs{of_weight} are too few; a source of dimension "
            f"{source.dim} needs at least {least} for {purpose}."
        )


def _checked_weights(weights, k: int) -> np.ndarray:
    if weights is None:
        return np.ones(k)
    weights = as_numbers("weights", weights)
    if weights.shape != (k,):
        raise ValueError(
            f"weights: expected shape ({k},), one for each pair, found {weights.shape}."
        )
    bad = np.flatnonzero(~(np.isfinite(weights) & (weights >= 0)))
    if len(bad):
        raise ValueError(
            f"weights: must be positive or zero, and finite; {len(bad)} of {k} are not, "
            f"first {shown(weights[bad[0]])} at index {bad[0]}."
        )
    if not 0 < np.sum(weights) < np.inf:
        raise ValueError(
            f"weights: their sum is {shown(np.sum(weights))}; only ratios matter, so give "
            "numbers about 1, and not zero for all."
        )
    return weights
