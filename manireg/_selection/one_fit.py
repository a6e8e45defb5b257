"""One fit of all data a lambda, and what is known from it by the leverages."""

from typing import NamedTuple

import equinox as eqx
import numpy as np

from .._objective.arguments import argument
from .._objective.problem import Problem
from .._programs.program import program
from .._solver.fitted import Limits, fitted, scored_data
from .._solver.linear import AbstractSolvers, direct_solvers
from .._solver.minima import lowest
from .._solver.minimum import is_successful
from .._solver.model import RegressionMap, regression_map
from .._solver.spread import Spread, spread_of
from .._solver.starts import free_solution, starts_of
from .criteria import AbstractCriterion
from .scores import AbstractScore, Fit

RTOL = 1e-4  # predicted relative decrease of the last Newton step
STEPS_TO_THE_END = 256
TO_THE_END = Limits(1e-12, STEPS_TO_THE_END, certify=True)  # of the one that is chosen


class Found(NamedTuple):
    """Of one fit."""

    model: RegressionMap
    spread: Spread


class OneFit(AbstractScore):
    """Judged by a criterion; `scores` are lengths of the residual of each datum in the fit
    without it, to first order, times its relative weight; see `scored_data`."""

    problem: Problem
    criterion: AbstractCriterion
    linear_algebra: str = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    given: Problem
    """The problem as programs see it."""
    warm: RegressionMap | None
    """A map near by, to start from."""

    def __init__(
        self,
        problem: Problem,
        criterion: AbstractCriterion,
        linear_algebra: str,
        max_steps: int,
        warm: RegressionMap | None = None,
    ):
        self.problem, self.given = problem, argument(problem)
        self.criterion, self.warm = criterion, warm
        self.linear_algebra, self.max_steps = linear_algebra, max_steps

    @property
    def _solvers(self) -> AbstractSolvers:
        return direct_solvers(self.problem, self.linear_algebra)

    def start(self, lam):
        if self.warm is not None:
            return self.warm.coefficients
        start = _free if self.problem.energy.order <= 2 else _projected
        return start(self.given, lam, self._solvers)

    def fit(self, lam, place):
        limits = Limits(RTOL, self.max_steps, certify=False)
        model, seen = self._fit(lam, place, limits, scored=True)
        weights = np.asarray(self.problem.weights)
        scored = scored_data(self.problem)
        # in units of the mean weight
        errors = seen.errors * weights[scored] / np.mean(weights[weights > 0])
        scores = np.nan_to_num(errors, nan=np.inf)
        w = model.coefficients
        # a fit that ends in no numbers is no start for the next
        place = w if np.all(np.isfinite(np.asarray(w))) else place
        converged = np.full(scores.shape, is_successful(model.result))
        found = Found(model, spread_of(self.problem, lam, model.energies, seen))
        return Fit(place, scores, converged, _total(model), found)

    def judged(self, lams, fits):
        errors = np.stack([fit.scores for fit in fits], axis=1)
        return self.criterion.judged(lams, errors, _spreads(fits))

    @property
    def refinements(self):
        return self.criterion.refinements

    def better(self, lams, fits):
        return self.criterion.better(lams, self.judged(lams, fits), _spreads(fits))

    def model(self, lam, fits):
        """By the program of the path, now to the end: the lowest of both, of equals the
        one that converged."""
        places = [fit.place for fit in fits]
        models = [self._fit(lam, w, TO_THE_END, scored=False)[0] for w in places]
        return lowest(models, _total, lambda model: is_successful(model.result))

    def _fit(self, lam, place, limits: Limits, scored: bool):
        found, seen = fitted(
            self.given, lam, place, limits, self._solvers, scored=scored
        )
        fit = found.w, lam, found.energies, found.result, found.stats
        return regression_map(self.problem, *fit), seen


def _spreads(fits) -> list[Spread | None]:
    return [None if fit.found is None else fit.found.spread for fit in fits]


def _total(model: RegressionMap) -> float:
    """The objective, but for the pull towards N; infinite if it is not a number."""
    parts = (model.energies.loss, model.lam, model.energies.energy)
    loss, lam, energy = map(float, parts)
    return float(np.nan_to_num(loss + lam * energy, nan=np.inf))


_free = program(most=8)(free_solution)


@program(most=8)
def _projected(problem: Problem, lam, solvers):
    """On N: derivatives of a higher order of a map that leaves it are large."""
    return starts_of(problem, lam, (1.0,), "projected", solvers)[0][0]
