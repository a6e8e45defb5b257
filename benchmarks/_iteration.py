"""A Newton iteration next to its factorisation."""

import equinox as eqx
import jax
import numpy as np
import sparsax
from _timing import first_and_best

from manireg._algebra.cholesky import SparseCholesky
from manireg._objective.hessian import gauss_newton
from manireg._objective.objective import objective
from manireg._objective.sites import Stage
from manireg._solver.linear import direct_solvers


@eqx.filter_jit
def _iterate(w, stage: Stage):
    value = eqx.filter_value_and_grad(objective, has_aux=True)
    (total, _), gradient = value(w, stage)
    solver = direct_solvers(stage.problem, "sparse").positive
    state = solver.init(gauss_newton(w, stage), {})
    return total, solver.compute(state, gradient, {})[0]


@eqx.filter_jit
def _system(w, stage: Stage):
    return SparseCholesky().init(gauss_newton(w, stage), {})


def newton_iteration(w, stage: Stage, repeats: int) -> tuple[float, float]:
    """Seconds of value, gradient, Gauss-Newton matrix and its solve; and those of
    CHOLMOD's factorisation of that matrix, with its solve, alone. After a first call:
    CHOLMOD's analysis is done once, and its factor kept while the values are the same,
    so they differ."""
    (i, j, values), *_ = _system(w, stage)
    factorise = jax.jit(sparsax.solve)
    side = w.ravel()
    return (
        best(lambda factor: _iterate(w * factor, stage), repeats),
        best(lambda factor: factorise(i, j, values * factor, side), repeats),
    )


def best(call, repeats: int) -> float:
    """Least seconds of `call(factor)`, the factor about 1 and never the same."""
    factors = iter(1 + 1e-7 * np.arange(1, repeats + 2))
    return first_and_best(lambda: call(next(factors)), repeats)[1]
