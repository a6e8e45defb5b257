"""Along log lambda: one fit after another, each started where the one before ended. In
which order is a plan, made beforehand; what is fitted is the score's business."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from .._input.precision import as_scalar
from .progress import Progress
from .scores import AbstractScore, Fit

HOPELESS = 2.0  # times the best mean score
LOWER = 1e-2  # by which an objective has to be lower to be that of another minimum


class Leg(NamedTuple):
    """Lambdas to visit one after another; ends at one that has been visited before, or
    with `again` at one where it finds no lower objective than that visit did."""

    lams: Sequence[float]
    after: float | None = None
    """The visited lambda from which it goes on; None: from the score's own start."""
    limit: float = np.inf
    """Ends where the mean score is so many times the lowest on the way."""
    again: bool = False


def up_and_down(
    grid: Sequence[float], middle: float, to_the_end: bool
) -> Sequence[Leg]:
    """From the lambda next to `middle` up and down, as far as there is hope. `to_the_end`:
    all the way down, and what is left above from its upper end downwards."""
    at = int(np.argmin(np.abs(np.log(np.asarray(grid) / middle))))
    first, above, below = grid[at], grid[at + 1 :], grid[:at][::-1]
    down_to = np.inf if to_the_end else HOPELESS
    plan = [Leg([first]), Leg(above, first, HOPELESS), Leg(below, first, down_to)]
    return [*plan, Leg(above[::-1])] if to_the_end else plan


def around(grid: Sequence[float], middle: float) -> Sequence[Leg]:
    """From the lambda next to `middle`, of which there is a map, up and down."""
    at = int(np.argmin(np.abs(np.log(np.asarray(grid) / middle))))
    first = grid[at]
    return [Leg([first]), Leg(grid[at + 1 :], first), Leg(grid[:at][::-1], first)]


def downwards(grid: Sequence[float]) -> Sequence[Leg]:
    """From the largest lambda to the least, whatever the scores on the way: a path that
    begins in a wrong minimum leaves it late (measured: one of 60 tracks of orientations,
    near the end), or never (a sheet that is rolled up). So the least lambda is fitted once
    more, from a start that follows the data, and the path goes back up as long as it
    lies below the one that came down."""
    down = Leg(grid[::-1])
    return [down, Leg(grid, again=True)] if len(grid) > 1 else [down]


def follow(
    score: AbstractScore,
    plan: Sequence[Leg],
    visited: Mapping[float, Fit],
    progress: bool,
) -> dict[float, Fit]:
    """The fits of the plan, in addition to those `visited` before it."""
    fits: dict[float, Fit] = {}
    lowest = np.inf
    planned = len({lam for leg in plan for lam in leg.lams})
    with Progress(planned, "lambdas", progress) as bar:
        for leg in plan:
            place = None if leg.after is None else {**visited, **fits}[leg.after].place
            for lam in leg.lams:
                before = fits.get(lam)
                if before is not None and not leg.again:
                    break
                # a Python number would be compiled into the program
                traced = as_scalar(lam)
                place = score.start(traced) if place is None else place
                fit = score.fit(traced, place)
                if before is None:
                    bar.step()
                elif not fit.objective < (1 - LOWER) * before.objective:
                    break
                fits[lam], place = fit, fit.place
                mean = float(np.mean(fit.scores))
                lowest = min(lowest, mean)
                if mean > leg.limit * lowest:
                    break
    return fits
