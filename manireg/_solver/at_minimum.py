"""A fitted map seen from inside: the Hessian there, the leverages of its data, and how
these scatter."""

import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._algebra.sparse import SparseSymmetric
from .._objective.arguments import argument
from .._objective.hessian import gauss_newton
from .._objective.objective import objective
from .._objective.problem import Problem, number_of_data
from .._objective.sites import misfit_alone, sites
from .._programs.program import program
from .draws import root
from .fitted import asked, of_asked, scored_data
from .leverages import Leverages, leverages
from .linear import AbstractSolvers, direct_solvers
from .minimise import projected_stage
from .spread import Spread, spread_of

PROBES = 64  # random vectors, for traces to some per cent


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


def lambda_error(model: Any, found: AtMinimum) -> Float[np.ndarray, "KC t"]:
    r"""$\sqrt V\, dw / d \log \lambda$, V the variance of $\log \lambda$ by the curvature
    of the restricted likelihood (Wood, Pya and Saefken 2016, of their correction the first
    part): with $dw / d \log \lambda = - H^{-1} g$, $g = \lambda \nabla S$, and
    $2 / V = k (\lambda S - g^\top H^{-1} g) / \hat\sigma^2 - d\,\mathrm{edf} / d \log
    \lambda$, where $- d\,\mathrm{edf} / d \log \lambda = \mathrm{edf} -
    \mathrm{tr}(A^2)$, A what data do to their fitted values."""
    along = _along_lambda(
        found.given, model.lam, model.coefficients, found.hessian, found.solvers
    )
    moved, promised, trace, square = map(np.asarray, along)
    spread, k = found.spread, number_of_data(model.problem)
    lost = spread.edf * (1 - square / trace)
    curvature = (spread.penalty - k * promised) / spread.variance + lost
    # less: the likelihood is flat, and says nothing of lambda; a variance of 4, of
    # wavelengths a factor of 1.6 for order two, is as far as first order goes
    return math.sqrt(2 / max(curvature, 0.5)) * moved


@program(most=4)
def _seen(problem, lam, w, data, solvers):
    stage = projected_stage(problem, lam, w)
    hessian = gauss_newton(w, stage)
    return hessian, leverages(w, stage, hessian, solvers, data)


@program(most=4)
def _along_lambda(problem, lam, w, hessian, solvers):
    stage = projected_stage(problem, lam, w)
    g = jax.grad(lambda w: lam * objective(w, stage)[1].energy)(w)
    solve = functools.partial(
        solvers.positive.compute, solvers.positive.init(hessian, {}), options={}
    )
    moved = -solve(g)[0]
    # both traces of what data do to data, by random signs (Hutchinson 1990)
    at_data = functools.partial(root, misfit_alone(sites(stage)[1]), stage)
    r, push = jax.linearize(at_data, w)
    pull = jax.linear_transpose(push, w)
    signs = jax.random.rademacher(jax.random.key(0), (PROBES, *r.shape), r.dtype)
    sides = jax.vmap(lambda z: pull(z)[0], out_axes=-1)(signs)
    fitted = 2 * jax.vmap(push, in_axes=-1)(solve(sides)[0])
    trace, square = jnp.sum(signs * fitted), jnp.sum(fitted**2)
    return moved, -jnp.sum(g * moved), trace / PROBES, square / PROBES
