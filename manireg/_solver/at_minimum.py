"""A fitted map seen from inside: the Hessian there, the leverages of its data, and how
these scatter."""

import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._algebra.sparse import SparseSymmetric
from .._objective.arguments import argument
from .._objective.hessian import gauss_newton
from .._objective.objective import Energies, objective
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
    lam: Float[Array, ""]
    w: Float[Array, "KC t"]
    solvers: AbstractSolvers
    hessian: SparseSymmetric
    """The Gauss-Newton model: every term's curvature but that of its residuals."""
    data: np.ndarray
    """Indices of the `scored_data`, of which all below is."""
    leverages: Leverages
    spread: Spread


def at_minimum(model: Any) -> AtMinimum:
    """Of a `RegressionMap`. **Raises** ValueError for one without its problem."""
    return seen_at(problem_of(model), model.lam, model.coefficients, model.energies)


def seen_at(
    problem: Problem, lam: Float[Array, ""], w: Float[Array, "KC t"], energies: Energies
) -> AtMinimum:
    """Of the fit at `lam` with coefficients `w`."""
    given, solvers = argument(problem), direct_solvers(problem)
    data = scored_data(problem)
    hessian, seen = _seen(given, lam, w, asked(problem, data), solvers)
    seen = of_asked(problem, data, seen)
    spread = spread_of(problem, lam, energies, seen)
    return AtMinimum(given, lam, w, solvers, hessian, data, seen, spread)


def problem_of(model: Any) -> Problem:
    """**Raises** ValueError for a map without its problem."""
    if model.problem is None:
        raise ValueError(
            "This map has left its problem behind: it was fitted under `jit` or `vmap`, "
            "or stored alone. Fit it outside of them, or give it back by "
            "`dataclasses.replace(model, problem=problem)`."
        )
    return model.problem


def lambda_error(
    problem: Problem, found: AtMinimum
) -> tuple[float, Float[np.ndarray, "KC t"]]:
    r"""$V$, the variance of $\log \lambda$ by the curvature of the restricted likelihood,
    infinite where that says nothing, and $dw / d \log \lambda$ (Wood, Pya and Saefken
    2016, of their correction the first part):

    $$\frac{dw}{d \log \lambda} = - H^{-1} g, \quad g = \lambda \nabla S, \qquad
    \frac{2}{V} = \frac{k (\lambda S - g^\top H^{-1} g)}{\hat\sigma^2}
    + \mathrm{edf} - \mathrm{tr}(A^2),$$

    A what data do to their fitted values."""
    along = _along_lambda(found.given, found.lam, found.w, found.hessian, found.solvers)
    moved, promised, trace, square = map(np.asarray, along)
    spread, k = found.spread, number_of_data(problem)
    lost = spread.edf * (1 - square / trace)
    curvature = (spread.penalty - k * promised) / spread.variance + lost
    return float(2 / curvature) if curvature > 0 else math.inf, moved


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
