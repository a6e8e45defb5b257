"""What a lambda is judged by: how far fits are from data that they have not seen.

`KFold` fits without each fold and looks at the fold; `LeaveOneOut` fits once, and predicts
from the Hessian what each datum would miss if left out."""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PyTree

from .._objective.arguments import argument, of_data
from .._objective.objective import objective
from .._objective.problem import Problem, psi_at_data
from .._programs.program import program
from .._solver.leverages import left_out_errors
from .._solver.linear import AbstractSolvers, direct_solvers
from .._solver.minimise import gauge, minimise, newton_minimiser, stage_of
from .._solver.model import RegressionMap, regression_map
from .._solver.solve import solve
from .._solver.starts import free_solution, starts_of
from .folds import held_out_error
from .sweep import sweep

# Data whose errors are predicted, but on curves, where all are: elsewhere each takes t
# solves with the factor. A thousand tell lambdas apart as well as ten thousand.
SCORED = 1000
# Predicted relative decrease of the last Newton step of a fold's fit. 3e-3 saves a fifth
# of the time; measured on curves, errors that change mostly grow by 1 to 3 %.
COARSE = 1e-3
RTOL = 1e-4  # the same of a fit to all data
TO_THE_END = 1e-12, 256  # the same of the fit that is chosen, and trial steps for it


class Fit(NamedTuple):
    """All that was found at one lambda."""

    place: PyTree
    """Where the path goes on from."""
    scores: Float[np.ndarray, " folds"]
    converged: Bool[np.ndarray, " folds"]
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
    def model(self, lam: Float[Array, ""], fit: Fit) -> RegressionMap:
        """The map of all data at `lam`."""


def _solvers(score: "KFold | LeaveOneOut") -> AbstractSolvers:
    return direct_solvers(score.linear_algebra, score.problem.basis.dim)


class KFold(AbstractScore):
    """Mean geodesic error on each held-out fold. Folds are 0/1 weights: all fits share one
    compiled program, and several devices share the folds."""

    problem: Problem
    training: Bool[np.ndarray, "folds k"]
    linear_algebra: str = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)

    def start(self, lam):
        shared = lam, argument(self.problem), _solvers(self)
        return sweep(_start, self._lanes, shared)

    def fit(self, lam, place):
        max_steps = np.asarray(self.max_steps)
        shared = lam, argument(self.problem), _solvers(self), max_steps
        place, *rest = sweep(_advance, (self._lanes, place), shared)
        scores, converged, w = map(np.asarray, (*rest, place.w))
        return Fit(place, scores, converged, w)

    def trimmed(self, scores):
        return scores

    @property
    def _lanes(self) -> Bool[np.ndarray, "folds size"]:
        """With what the problem is filled up with, of weight 0."""
        return of_data(self.training.T, len(self.problem.y)).T

    def model(self, lam, fit):
        warm = _lowest(fit.found, argument(self.problem), lam)
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
    relative weight; but on curves, of at most `SCORED` random data."""

    problem: Problem
    linear_algebra: str = eqx.field(static=True)
    max_steps: int = eqx.field(static=True)

    def start(self, lam):
        return _free(argument(self.problem), lam, _solvers(self))

    def fit(self, lam, place):
        model, errors, successful = self._fit(lam, place, RTOL, self.max_steps, False)
        weights = np.asarray(self.problem.weights)
        scored = self._scored
        errors = np.asarray(errors)
        errors = errors[scored] if self._on_curve else errors[: len(scored)]
        # in units of the mean weight
        errors = errors * weights[scored] / np.mean(weights[weights > 0])
        scores = np.nan_to_num(errors, nan=np.inf)
        w = model.coefficients
        # a fit that ends in no numbers is no start for the next
        place = w if np.all(np.isfinite(np.asarray(w))) else place
        return Fit(place, scores, np.full(scores.shape, successful), model)

    def trimmed(self, scores):
        return cut_errors(scores)

    def model(self, lam, fit):
        """By the program of the path, now to the end."""
        return self._fit(lam, fit.place, *TO_THE_END, True)[0]

    def _fit(self, lam, place, rtol: float, max_steps: int, certify: bool):
        limits = np.asarray(rtol), np.asarray(max_steps), np.asarray(certify)
        scored = self._scored
        wanted = of_data(scored, len(scored)), np.asarray(len(scored))
        found, errors, successful = _fit_and_score(
            argument(self.problem),
            lam,
            place,
            _solvers(self),
            None if self._on_curve else wanted,
            *limits,
        )
        return regression_map(self.problem, *found), errors, bool(successful)

    @property
    def _on_curve(self) -> bool:
        return self.problem.basis.dim == 1

    @property
    def _scored(self) -> Int[np.ndarray, " n"]:
        """Indices of the data that are, always the same."""
        heavy = np.flatnonzero(np.asarray(self.problem.weights) > 0)
        if self._on_curve or len(heavy) <= SCORED:
            return heavy
        return np.sort(np.random.default_rng(0).choice(heavy, SCORED, replace=False))


def cut_errors(errors: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """The largest tenth cut to the ninth decile; all infinite where one is."""
    if not np.all(np.isfinite(errors)):
        return np.full_like(errors, np.inf)
    return np.minimum(errors, np.quantile(errors, 0.9))


_free = program(most=16)(free_solution)


@program(most=16)
def _fit_and_score(
    problem: Problem, lam, w, solvers: AbstractSolvers, scored, rtol, max_steps, certify
):
    newton = newton_minimiser(
        solvers, rtol, max_steps, certify=certify, keep_model=True
    )
    found = minimise(problem, lam, w, "projected", newton)
    stage = stage_of(problem, lam, found.gamma, "projected", found.w)
    errors = jax.lax.cond(
        certify,
        # the fit that is chosen needs none
        lambda: jnp.zeros(len(problem.y if scored is None else scored[0])),
        lambda: left_out_errors(found.w, stage, found.model, solvers, scored),
    )
    fit = found.w, lam, found.energies, found.result, found.stats
    return fit, errors, found.result == optx.RESULTS.successful
