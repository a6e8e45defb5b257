"""From scores to the lambda chosen: that of the lowest mean, on grids that grow until it
lies inside, or between the values of coarse ones; and the result of every choice."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._input.precision import as_scalar
from .._objective.arguments import on_host
from .._objective.problem import Problem
from .._objective.wavelengths import wavelength_of_lambda
from .._solver.model import RegressionMap
from .path import Leg, follow
from .scores import AbstractScore, Fit

WIDENINGS = 2  # times a default grid may be extended past an edge


class CrossValidation(eqx.Module):
    """Scores of a grid of lambdas, the one chosen, and its map of all data."""

    references = ("stone1974cross",)

    lam: Float[Array, ""]
    """The one chosen."""
    lams: Float[Array, " lams"]
    """The grid, ascending."""
    scores: Float[Array, "folds lams"]
    """Error on what each fold leaves out. Of `cross_validate` the (weighted) mean geodesic
    error; of `leave_one_out`, where every datum of positive weight (or each of a
    thousand) is a fold, the predicted length of its residual, times its relative
    weight. Infinite where not tried."""
    converged: Bool[Array, "folds lams"]
    """Where Newton converged."""
    model: RegressionMap
    """Fitted to all data with `lam`."""
    criterion: Float[Array, " lams"]
    """What is lowest at `lam`: mean scores, those of `leave_one_out` with their largest
    tenth cut to the ninth decile, or another criterion that it was asked for."""
    wavelengths: Float[Array, " lams"]
    """Those at which each of `lams` damps a perturbation by a half (see `lambda_grid`):
    comparable between orders."""
    order: int = eqx.field(static=True)
    """Of the energy."""
    others: dict[int, "CrossValidation"] = eqx.field(default_factory=dict)
    """The same of other orders that were tried."""

    @property
    def paths(self) -> dict[int, "CrossValidation"]:
        """By order, ascending: of all that were tried the grids, scores and maps."""
        own = dataclasses.replace(self, others={})
        return dict(sorted({**self.others, self.order: own}.items()))

    @property
    def score(self) -> Float[Array, ""]:
        """Mean score at the chosen lambda."""
        return as_scalar(np.mean(self.scores, axis=0)[self.chosen])

    @property
    def chosen(self) -> Int[Array, ""]:
        """Index of `lam` in `lams`."""
        return jax.device_put(np.argmin(np.abs(np.asarray(self.lams) - self.lam)))

    @property
    def on_edge(self) -> Bool[Array, ""]:
        """Whether `lam` is the first or last of `lams`: beyond may lie a better one."""
        return (self.chosen == 0) | (self.chosen == len(self.lams) - 1)


def choose(
    problem: Problem,
    score: AbstractScore,
    grid: Float[np.ndarray, " n"],
    plan: Callable[[Sequence[float]], Sequence[Leg]],
    *,
    widen: bool = False,
    refine: bool = False,
    progress: bool,
) -> CrossValidation:
    """Of the lambdas that `plan` visits in the grid, with `widen` past its edges, and with
    `refine` a few more around the lowest."""
    fits: dict[float, Fit] = {}

    def evaluate(grid):
        lams = np.asarray(grid).tolist()
        fits.update(follow(score, plan(lams), fits, progress))
        return gathered(lams)

    def gathered(lams):
        one = next(iter(fits.values())).scores
        untried = Fit(
            None, np.full_like(one, np.inf), np.zeros(one.shape, bool), np.nan, None
        )
        columns = [fits.get(lam, untried) for lam in lams]
        scores = np.stack([fit.scores for fit in columns], axis=1)
        converged = np.stack([fit.converged for fit in columns], axis=1)
        return score.judged(lams, columns), scores, converged

    lams, results, best = evaluated(grid, evaluate, widen)
    lams = np.asarray(lams)
    for _ in range(score.refinements if refine else 0):
        tried = [fits[lam] for lam in lams.tolist()]
        lam = score.better(lams.tolist(), tried)
        if lam is None:
            break
        nearest = Leg([lam], after=float(lams[best]))
        fits.update(follow(score, [nearest], fits, progress=False))
        lams = np.sort(np.append(lams, lam))
        results = gathered(lams.tolist())
        best = lowest(results[0])
    scores, converged = jax.device_put(results[1:])
    # a path downwards leaves wrong minima late: the next fit may lie in a lower one
    near = [
        fits[lam] for lam in lams[max(best - 1, 0) : best + 1].tolist() if lam in fits
    ]
    model = score.model(as_scalar(lams[best]), near)
    wavelengths = wavelength_of_lambda(on_host(problem), lams)
    chosen, criterion = lams[best], np.mean(np.asarray(results[0]), axis=0)
    chosen, lams, criterion, wavelengths = jax.device_put(
        (chosen, lams, criterion, wavelengths)
    )
    return CrossValidation(
        lam=chosen,
        lams=lams,
        scores=scores,
        converged=converged,
        model=model,
        criterion=criterion,
        wavelengths=wavelengths,
        order=problem.energy.order,
    )


def lowest(scores: Float[Array | np.ndarray, "folds n"]) -> int:
    """Index of the lowest mean, of those that are numbers."""
    means = np.mean(np.asarray(scores), axis=0)
    if not np.any(np.isfinite(means)):
        raise ValueError(
            "cross-validation: no value of the grid has a finite score. Check the scale "
            "of the data, or give a grid of your own, or a value."
        )
    return int(np.argmin(np.where(np.isnan(means), np.inf, means)))


def evaluated(
    grid: Float[Array | np.ndarray, " n"],
    evaluate: Callable[[Array], Any],
    widen: bool,
) -> tuple[Array, Any, int]:
    """`grid`, `evaluate(grid)` and the index of the value whose mean score is lowest.

    `evaluate` gives a tuple of arrays `(folds, n, ...)`, scores first. With `widen`, while
    the lowest sits on an edge, the grid is extended past it by a quarter of its range, at
    most twice (in as many values as before: compiled programs are used again).
    """
    grid = np.asarray(grid)
    quarters = 0.25 * np.arange(1, len(grid) + 1) / len(grid)
    up = (grid[-1] / grid[0]) ** quarters
    host = lambda arrays: jax.tree.map(np.asarray, arrays)
    results = host(evaluate(jax.device_put(grid)))
    for _ in range(WIDENINGS if widen else 0):
        best = lowest(results[0])
        if 0 < best < len(grid) - 1:
            break
        below = best == 0
        new = grid[0] / up[::-1] if below else grid[-1] * up
        join = lambda old, new, axis: np.concatenate(
            [new, old] if below else [old, new], axis=axis
        )
        more = host(evaluate(jax.device_put(new)))
        results = jax.tree.map(lambda a, b: join(a, b, 1), results, more)
        grid = join(grid, new, 0)
    return *jax.device_put((grid, results)), lowest(results[0])
