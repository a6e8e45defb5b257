"""Fits without each fold, judged by the fold."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from .._objective.arguments import argument, of_data
from .._objective.objective import objective
from .._objective.problem import Problem, psi_at_data
from .._programs.program import program
from .._solver.linear import AbstractSolvers, direct_solvers
from .._solver.minimise import minimise, newton_minimiser, projected_stage
from .._solver.solve import solve
from .._solver.starts import starts_of
from .folds import held_out_error
from .scores import AbstractScore, Fit
from .sweep import sweep

# Predicted relative decrease of the last Newton step of a fold's fit. 3e-3 saves a fifth
# of the time; measured on curves, errors that change mostly grow by 1 to 3 %.
COARSE = 1e-3


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

    @property
    def _solvers(self) -> AbstractSolvers:
        return direct_solvers(self.problem, self.linear_algebra)

    def start(self, lam):
        return sweep(_start, self.lanes, (lam, self.given, self._solvers))

    def fit(self, lam, place):
        shared = lam, self.given, self._solvers, np.asarray(self.max_steps)
        place, *rest = sweep(_advance, (self.lanes, place), shared)
        scores, converged, w = map(np.asarray, (*rest, place.w))
        return Fit(place, scores, converged, np.nan, w)

    def judged(self, lams, fits):
        return np.stack([fit.scores for fit in fits], axis=1)

    @property
    def refinements(self):
        return 0

    def better(self, lams, fits):
        return None

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
        stage = projected_stage(problem, lam, w)
        return objective(w, stage)[0]

    totals = jnp.nan_to_num(jax.lax.map(total, w), nan=jnp.inf)
    return w[jnp.argmin(totals)]
