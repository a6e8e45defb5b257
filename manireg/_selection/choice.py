"""From scores to the lambda chosen: rules, grids that grow until the choice lies inside,
and the result of every choice."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._input.precision import as_scalar
from .._solver.model import RegressionMap
from .path import Leg, follow
from .scores import AbstractScore, Fit

WIDENINGS = 2  # times a default grid may be extended past an edge

Rule = Literal["lowest", "one standard error"]


class CrossValidation(eqx.Module):
    """Scores of a grid of lambdas, the one chosen, and its map of all data."""

    lam: Float[Array, ""]
    """The one chosen."""
    lams: Float[Array, " lams"]
    """The grid, ascending."""
    scores: Float[Array, "folds lams"]
    """Error on what each fold leaves out. Of `cross_validate` the (weighted) mean geodesic
    error; of `leave_one_out`, where every datum of positive weight is a fold, the
    predicted length of its residual, times its relative weight. Infinite where not
    tried."""
    converged: Bool[Array, "folds lams"]
    """Where Newton converged."""
    model: RegressionMap
    """Fitted to all data with `lam`."""
    rule: Rule = eqx.field(static=True, default="lowest")
    """What chose: the `"lowest"` mean score (`cross_validate`), or the largest lambda
    within `"one standard error"` of it (`leave_one_out`)."""

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
    score: AbstractScore,
    grid: Float[np.ndarray, " n"],
    plan: Callable[[Sequence[float], Mapping[float, Fit]], Sequence[Leg]],
    rule: Rule,
    *,
    widen: bool,
    ratios: Float[np.ndarray, " r"] | None = None,
    progress: bool,
) -> CrossValidation:
    """Of the lambdas that `plan` visits in the grid (given those visited before), and with
    `widen` past its edges."""
    fits: dict[float, Fit] = {}

    def evaluate(grid):
        lams = np.asarray(grid).tolist()
        found = follow(score, plan(lams, fits), fits, progress)
        fits.update(found)
        one = next(iter(found.values())).scores
        untried = Fit(None, np.full_like(one, np.inf), np.zeros(one.shape, bool), None)
        columns = [found.get(lam, untried) for lam in lams]
        trimmed = [score.trimmed(fit.scores) for fit in columns]
        scores = [fit.scores for fit in columns]
        converged = [fit.converged for fit in columns]
        return tuple(np.stack(a, axis=1) for a in (trimmed, scores, converged))

    lams, (_, scores, converged), best = evaluated(
        grid, evaluate, widen, RULES[rule], ratios
    )
    model = score.model(as_scalar(lams[best]), fits[float(lams[best])])
    arrays = jax.device_put((np.asarray(lams[best]), lams, scores, converged))
    return CrossValidation(*arrays, model, rule)


def lowest(scores: Float[np.ndarray, "folds n"]) -> int:
    """Index of the lowest mean, of those that are numbers."""
    means = np.mean(scores, axis=0)
    if not np.any(np.isfinite(means)):
        raise ValueError(
            "cross-validation: no value of the grid has a finite score. Check the scale "
            "of the data, or give a grid of your own, or a value."
        )
    return int(np.argmin(np.where(np.isnan(means), np.inf, means)))


def one_standard_error(scores: Float[np.ndarray, "folds n"]) -> int:
    """Index of the largest value whose mean lies within one standard error of the lowest
    (Breiman, Friedman, Olshen and Stone 1984, section 3.4.3)."""
    best = scores[:, lowest(scores)]
    allowed = best.mean() + best.std(ddof=1) / np.sqrt(len(best))
    return int(np.flatnonzero(np.mean(scores, axis=0) <= allowed)[-1])


RULES: Mapping[Rule, Callable[[np.ndarray], int]] = {
    "lowest": lowest,
    "one standard error": one_standard_error,
}


def evaluated(
    grid: Float[Array | np.ndarray, " n"],
    evaluate: Callable[[np.ndarray], Any],
    widen: bool,
    rule: Callable[[np.ndarray], int] = lowest,
    ratios: Float[np.ndarray, " r"] | None = None,
) -> tuple[np.ndarray, Any, int]:
    """`grid`, `evaluate(grid)` and the index of the value that the rule chooses.

    `evaluate` gives a tuple of arrays `(folds, n, ...)`, scores first. With `widen`, while
    the best mean score sits on the lower edge or the choice on the upper one, the grid is
    extended past it, at most twice: by `ratios`, default a quarter of its range (in as
    many values as before: compiled programs are used again).
    """
    grid = np.asarray(grid)
    quarters = 0.25 * np.arange(1, len(grid) + 1) / len(grid)
    up = (grid[-1] / grid[0]) ** quarters if ratios is None else ratios
    host = lambda arrays: jax.tree.map(np.asarray, arrays)
    results = host(evaluate(grid))
    for _ in range(WIDENINGS if widen else 0):
        below = lowest(results[0]) == 0
        if not below and rule(results[0]) < len(grid) - 1:
            break
        new = grid[0] / up[::-1] if below else grid[-1] * up
        join = lambda old, new, axis: np.concatenate(
            [new, old] if below else [old, new], axis=axis
        )
        more = host(evaluate(new))
        results = jax.tree.map(lambda a, b: join(a, b, 1), results, more)
        grid = join(grid, new, 0)
    return grid, results, rule(results[0])
