"""What a lambda is judged by: how far fits are from data that they have not seen.

`KFold` fits without each fold and looks at the fold; `LeaveOneOut` fits once, and predicts
from the Hessian what each datum would miss if left out."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, PyTree

from .._objective.arguments import argument, of_data
from .._objective.objective import objective
from .._objective.problem import Problem, psi_at_data
from .._programs.program import program
from .._solver.fitted import Limits, fitted, scored_data
from .._solver.linear import AbstractSolvers, direct_solvers
from .._solver.minimise import gauge, minimise, newton_minimiser, stage_of
from .._solver.minimum import is_successful
from .._solver.model import RegressionMap, regression_map
from .._solver.solve import solve
from .._solver.starts import free_solution, starts_of
from .folds import held_out_error
from .sweep import sweep

# Predicted relative decrease of the last Newton step of a fold's fit. 3e-3 saves a fifth
# of the time; measured on curves, errors that change mostly grow by 1 to 3 %.
COARSE = 1e-3
RTOL = 1e-4  # the same of a fit to all data
EQUAL = 1e-9  # relative difference of objectives that is not worth a look
STEPS_TO_THE_END = 256
TO_THE_END = Limits(1e-12, STEPS_TO_THE_END, certify=True)  # of the one that is chosen


class Fit(NamedTuple):
    """All that was found at one lambda."""

    place: PyTree
    """Where the path goes on from."""
    scores: Float[np.ndarray, " folds"]
    converged: Bool[np.ndarray, " folds"]
    objective: float
    """Of the map of all data; not a number where there is none."""
    found: Any
    """What the score makes its model of."""


class AbstractScore(eqx.Module):
    """Fits along a path, and their errors on data left out."""

    @abstractmethod
    def start(self, lam: Float[Array, ""]) -> PyTree:
        """A place from which to fit at `lam`, with no other fit to go on from."""

    @abstractmethod
    def fit(self, lam: Float[Array, ""], place: PyTree) -> Fit:
        """At `lam`, started from the place of a fit next to it."""

    @abstractmethod
    def trimmed(
        self, scores: Float[np.ndarray, " folds"]
    ) -> Float[np.ndarray, " folds"]:
        """What a rule should see of the scores at one lambda."""

    @abstractmethod
    def model(self, lam: Float[Array, ""], fits: Sequence[Fit]) -> RegressionMap:
        """The map of all data at `lam`; `fits`: that at the next smaller lambda, if it was
        visited, and last the one at `lam` itself."""


def _solvers(score: "KFold | LeaveOneOut") -> AbstractSolvers:
    return direct_solvers(score.problem, score.linear_algebra)


class KFold(AbstractScore):
    """Mean geodesic error on each held-out fold. Folds are 0/1 weights: all fits share one
    compiled program, and several devices share the folds."""

    problem: Problem
    linear_algebra: str = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    given: Problem
    """The problem as programs see it, and folds of it: what fills it up has weight 0."""
    lanes: Bool[np.ndarray, "folds size"]

    def __init__(
        self,
        problem: Problem,
        training: Bool[np.ndarray, "folds k"],
        linear_algebra: str,
        max_steps: int,
    ):
        self.problem, self.given = problem, argument(problem)
        self.lanes = of_data(training.T, len(problem.y)).T
        self.linear_algebra, self.max_steps = linear_algebra, max_steps

    def start(self, lam):
        return sweep(_start, self.lanes, (lam, self.given, _solvers(self)))

    def fit(self, lam, place):
        shared = lam, self.given, _solvers(self), np.asarray(self.max_steps)
        place, *rest = sweep(_advance, (self.lanes, place), shared)
        scores, converged, w = map(np.asarray, (*rest, place.w))
        return Fit(place, scores, converged, np.nan, w)

    def trimmed(self, scores):
        return scores

    def model(self, lam, fits):
        warm = _lowest(fits[-1].found, self.given, lam)
        return solve(self.problem, lam, warm=warm, linear_algebra=self.linear_algebra)


class _Place(eqx.Module):
    """Where the path of a fold has come to."""

    log_lam: Float[Array, ""]
    w: Float[Array, "KC t"]
    slope: Float[Array, "KC t"]
    """dw / d log lambda, from the last two fits."""


def _start(inside: Bool[Array, " k"], shared) -> _Place:
    lam, problem, solvers = shared
    fold = _fold(problem, inside)
    w = starts_of(fold, lam, (1.0,), "projected", solvers)[0][0]
    return _Place(jnp.log(lam), w, jnp.zeros_like(w))


def _advance(lane, shared):
    """On to the next lambda: the place, its score on the data not `inside`, and whether
    Newton converged."""
    (inside, place), (lam, problem, solvers, max_steps) = lane, shared
    newton = newton_minimiser(solvers, COARSE, max_steps)
    gap = jnp.log(lam) - place.log_lam
    start = place.w + gap * place.slope
    fold = _fold(problem, inside)
    found = minimise(fold, lam, start, "projected", newton)
    converged = found.result == optx.RESULTS.successful
    # a fit that ends in no numbers is no start for the next
    w = jnp.where(jnp.all(jnp.isfinite(found.w)), found.w, place.w)
    secant = (w - place.w) / jnp.where(gap == 0, jnp.inf, gap)
    slope = jnp.where(converged, secant, 0.0)
    place = _Place(jnp.log(lam), w, slope)
    score = jnp.nan_to_num(_held_out_error(problem, inside, w), nan=jnp.inf)
    return place, score, converged


def _fold(problem: Problem, inside) -> Problem:
    return eqx.tree_at(lambda p: p.weights, problem, problem.weights * inside)


def _held_out_error(problem: Problem, inside, w) -> Float[Array, ""]:
    values = psi_at_data(problem, w)
    predicted = problem.target.project(values.reshape(-1, *problem.target.point_shape))
    return held_out_error(problem.target, predicted, problem.y, problem.weights, inside)


@program(most=4)
def _lowest(w: Float[Array, "folds KC t"], problem: Problem, lam):
    """The map of lowest objective on all data: folds may lie in different minima."""

    def total(w):
        stage = stage_of(problem, lam, gauge(problem), "projected", w)
        return objective(w, stage)[0]

    totals = jnp.nan_to_num(jax.lax.map(total, w), nan=jnp.inf)
    return w[jnp.argmin(totals)]


class LeaveOneOut(AbstractScore):
    """Length of each datum's residual in the fit without it, to first order, times its
    relative weight; see `scored_data`."""

    problem: Problem
    linear_algebra: str = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)
    given: Problem
    """The problem as programs see it."""

    def __init__(self, problem: Problem, linear_algebra: str, max_steps: int):
        self.problem, self.given = problem, argument(problem)
        self.linear_algebra, self.max_steps = linear_algebra, max_steps

    def start(self, lam):
        start = _free if self.problem.energy.order <= 2 else _projected
        return start(self.given, lam, _solvers(self))

    def fit(self, lam, place):
        limits = Limits(RTOL, self.max_steps, certify=False)
        model, errors = self._fit(lam, place, limits, scored=True)
        weights = np.asarray(self.problem.weights)
        scored = scored_data(self.problem)
        # in units of the mean weight
        errors = errors * weights[scored] / np.mean(weights[weights > 0])
        scores = np.nan_to_num(errors, nan=np.inf)
        w = model.coefficients
        # a fit that ends in no numbers is no start for the next
        place = w if np.all(np.isfinite(np.asarray(w))) else place
        successful = is_successful(model.result)
        return Fit(
            place, scores, np.full(scores.shape, successful), _total(model), model
        )

    def trimmed(self, scores):
        return cut_errors(scores)

    def model(self, lam, fits):
        """By the program of the path, now to the end: the lowest of both, of equals the
        one that converged."""
        places = [fit.place for fit in fits]
        models = [self._fit(lam, w, TO_THE_END, scored=False)[0] for w in places]
        lowest = min(map(_total, models)) * (1 + EQUAL)
        equals = [model for model in models if _total(model) <= lowest] or models
        return min(equals, key=lambda model: not is_successful(model.result))

    def _fit(self, lam, place, limits: Limits, scored: bool):
        solvers = _solvers(self)
        found, errors = fitted(self.given, lam, place, limits, solvers, scored=scored)
        fit = found.w, lam, found.energies, found.result, found.stats
        return regression_map(self.problem, *fit), errors


def _total(model: RegressionMap) -> float:
    """The objective, but for the pull towards N; infinite if it is not a number."""
    parts = (model.energies.loss, model.lam, model.energies.energy)
    loss, lam, energy = map(float, parts)
    return float(np.nan_to_num(loss + lam * energy, nan=np.inf))


def cut_errors(errors: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """The largest tenth cut to the ninth decile; all infinite where one is."""
    if not np.all(np.isfinite(errors)):
        return np.full_like(errors, np.inf)
    return np.minimum(errors, np.quantile(errors, 0.9))


_free = program(most=8)(free_solution)


@program(most=8)
def _projected(problem: Problem, lam, solvers):
    """On N: derivatives of a higher order of a map that leaves it are large."""
    return starts_of(problem, lam, (1.0,), "projected", solvers)[0][0]
