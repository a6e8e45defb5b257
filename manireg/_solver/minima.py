"""Minima that several starts end in: how many, and how close."""

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .._objective.problem import Problem, psi_at_data
from .._objective.terms import project_flat
from .._programs.sizes import at_each
from .minimum import Minimum, is_successful

DISTINCT = 1e-6  # relative difference of objectives that one minimum does not have
ON_PATCHES = 1e-2  # likewise on point clouds, where Newton stops earlier
EQUAL = 1e-9  # relative difference that is not worth a look
ROUNDING = 1e-14  # of the mean square of the data: objectives below are all the same
CLOSE = 1e-2  # relative difference that does not decide between two maps


class SeveralMinimaWarning(UserWarning):
    """Two maps, clearly different, minimise the objective almost equally well."""


def lowest(
    fits: Sequence[Any],
    objective: Callable[[Any], float],
    converged: Callable[[Any], bool],
) -> Any:
    """Of equals one that converged: of two in one minimum rounding tells which is lower,
    and may keep one of them from being certified."""
    heights = np.nan_to_num([objective(fit) for fit in fits], nan=np.inf)
    least = heights.min() * (1 + EQUAL)
    equals = [fit for fit, height in zip(fits, heights, strict=True) if height <= least]
    return min(equals, key=lambda fit: not converged(fit))


def compared(problem: Problem, found: Sequence[Minimum]) -> dict[str, Any]:
    """`num_minima` of the starts that converged, and `second_minimum`, how much higher
    than the lowest the next one is, relatively; infinite if there is one minimum.

    Of an `argument(problem)`. **Warns** (`SeveralMinimaWarning`) where the second is less
    than 1 % higher, and the maps differ at the data by more than their residuals, in the
    root mean square."""
    reached = sorted(
        (m for m in found if is_successful(m.result)), key=lambda m: float(m.objective)
    )
    heights = np.array([float(m.objective) for m in reached])
    first = _steps_up(problem, heights)
    told = {"num_minima": np.array(len(first)), "second_minimum": np.array(np.inf)}
    if len(first) > 1:
        second = first[1]
        gap = heights[second] / heights[0] - 1
        told["second_minimum"] = np.array(gap)
        if gap < CLOSE:
            _warn_where_different(problem, reached[0], reached[second], gap)
    return told


def _steps_up(problem: Problem, heights: np.ndarray) -> list[int]:
    """Of ascending objectives those that are higher than the one before."""
    analytic = problem.target.known_points() is None
    share, mean = np.asarray(problem.weights), np.asarray(problem.origin)
    squares = np.sum((np.asarray(problem.y) - mean) ** 2, axis=1)
    least = ROUNDING * share @ squares / np.sum(share)
    tolerance = (DISTINCT if analytic else ON_PATCHES) * heights + least
    higher = np.diff(heights) > tolerance[:-1]
    return [0, *(1 + np.flatnonzero(higher)).tolist()][: len(heights)]


def _warn_where_different(problem: Problem, one: Minimum, other: Minimum, gap: float):
    ends = [
        at_each(project_flat, problem.target, np.asarray(psi_at_data(problem, m.w)))
        for m in (one, other)
    ]
    squares, weights = np.sum((ends[1] - ends[0]) ** 2, axis=1), problem.weights
    apart = np.sqrt(np.average(squares, weights=np.asarray(weights)))
    residual = float(one.energies.loss) ** 0.5
    if apart > residual:
        warnings.warn(
            f"starts: two different maps fit almost equally well: the objective of the "
            f"second is {100 * gap:.2g} % higher, and they are {apart:.3g} apart at the "
            f"data (root mean square; residuals {residual:.3g}). The lower one is "
            "returned; more data, or another `lam`, would decide.",
            SeveralMinimaWarning,
            stacklevel=5,
        )
