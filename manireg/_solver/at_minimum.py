"""A fitted map seen from inside: the Hessian there, the leverages of its data, and how
these scatter."""

from typing import Any, NamedTuple

import numpy as np

from .._algebra.sparse import SparseSymmetric
from .._objective.arguments import argument, of_data
from .._objective.hessian import gauss_newton
from .._objective.problem import Problem
from .._programs.program import program
from .fitted import scored_data
from .leverages import Leverages, leverages
from .linear import AbstractSolvers, direct_solvers
from .minimise import gauge, stage_of
from .spread import Spread, spread_of


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


def at_minimum(problem: Problem, model: Any) -> AtMinimum:
    """`model`: a `RegressionMap` fitted to the problem."""
    given, solvers = argument(problem), direct_solvers(problem)
    data, on_curve = scored_data(problem), problem.basis.dim == 1
    some = None if on_curve else (of_data(data, len(data)), np.asarray(len(data)))
    hessian, seen = _seen(given, model.lam, model.coefficients, some, solvers)
    own = data if on_curve else slice(len(data))
    seen = Leverages(*(np.asarray(a)[own] for a in seen))
    spread = spread_of(problem, model, seen)
    return AtMinimum(given, solvers, hessian, data, seen, spread)


@program(most=4)
def _seen(problem, lam, w, data, solvers):
    stage = stage_of(problem, lam, gauge(problem), "projected", w)
    hessian = gauss_newton(w, stage)
    return hessian, leverages(w, stage, hessian, solvers, data)
