"""A fitted map seen from inside: the Hessian there, the leverages of its data, and how
these scatter."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._algebra.sparse import SparseSymmetric
from .._objective.arguments import argument
from .._objective.hessian import gauss_newton
from .._objective.objective import objective
from .._objective.problem import Problem, number_of_data
from .._programs.program import program
from .fitted import asked, of_asked, scored_data
from .leverages import Leverages, leverages
from .linear import AbstractSolvers, direct_solvers
from .minimise import gauge, stage_of
from .spread import Spread, spread_of

STEP = 1.2  # of lambda, for the change of edf


class AtMinimum(NamedTuple):
    given: Problem
    """The problem as programs see it."""
    solvers: AbstractSolvers
    hessian: SparseSymmetric
    """The Gauss-Newton model: every term's curvature but that of its residuals."""
    data: np.ndarray
    """Indices of the `scored_data`, of which all below is."""
    leverages: Leverages
    spread: Spread


def at_minimum(model: Any) -> AtMinimum:
    """Of a `RegressionMap`. **Raises** ValueError for one without its problem."""
    problem = problem_of(model)
    given, solvers = argument(problem), direct_solvers(problem)
    data = scored_data(problem)
    hessian, seen = _seen(
        given, model.lam, model.coefficients, asked(problem, data), solvers
    )
    seen = of_asked(problem, data, seen)
    spread = spread_of(problem, model, seen)
    return AtMinimum(given, solvers, hessian, data, seen, spread)


def problem_of(model: Any) -> Problem:
    """**Raises** ValueError for a map without its problem."""
    if model.problem is None:
        raise ValueError(
            "This map has left its problem behind: it was fitted under `jit` or `vmap`, "
            "or stored alone. Fit it outside of them, or give it back by "
            "`dataclasses.replace(model, problem=problem)`."
        )
    return model.problem


def lambda_error(model: Any, found: AtMinimum) -> Float[Array, "KC t"]:
    r"""$\sqrt V\, dw / d \log \lambda$, V the variance of $\log \lambda$ by the curvature
    of the restricted likelihood (Wood, Pya and Saefken 2016, of their correction the first
    part): with $dw / d \log \lambda = - H^{-1} g$, $g = \lambda \nabla S$, and
    $2 / V = k (\lambda S - g^\top H^{-1} g) / \hat\sigma^2 - d\,\mathrm{edf} / d \log
    \lambda$."""
    given, lam, w = found.given, model.lam, model.coefficients
    moved, promised, edf = _along_lambda(
        given, lam, w, asked(model.problem, found.data), found.solvers, found.hessian
    )
    spread, k = found.spread, number_of_data(model.problem)
    lost = spread.edf * (1 - float(edf) / np.sum(found.leverages.leverages))
    gained = spread.penalty - k * float(promised)
    curvature = gained / spread.variance + lost / math.log(STEP)
    # less: the likelihood is flat, and says nothing of lambda; a variance of 4, of
    # wavelengths a factor of 1.6 for order two, is as far as first order goes
    variance = 2 / max(curvature, 0.5)
    return math.sqrt(variance) * moved


@program(most=4)
def _seen(problem, lam, w, data, solvers):
    stage = stage_of(problem, lam, gauge(problem), "projected", w)
    hessian = gauss_newton(w, stage)
    return hessian, leverages(w, stage, hessian, solvers, data)


@program(most=4)
def _along_lambda(problem, lam, w, data, solvers, hessian):
    stage = stage_of(problem, lam, gauge(problem), "projected", w)
    cost = lambda w: lam * objective(w, stage)[1].energy
    g = jax.grad(cost)(w)
    factor = solvers.positive.init(hessian, {})
    moved = -solvers.positive.compute(factor, g, {})[0]
    stage = stage_of(problem, STEP * lam, gauge(problem), "projected", w)
    seen = leverages(w, stage, gauss_newton(w, stage), solvers, data)
    weights = problem.weights if data is None else jnp.arange(len(data[0])) < data[1]
    own = jnp.where(weights > 0, jnp.sum(seen.leverages, axis=1), 0.0)
    return moved, -jnp.sum(g * moved), jnp.sum(own)
