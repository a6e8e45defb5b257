"""Time and bytes of every stage of a fit, next to the least they could be."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from _iteration import best, newton_iteration
from _timing import first_and_best

import manireg as mr
from manireg._discretisation.domain import centres_of, discretise
from manireg._discretisation.jets import jets_of
from manireg._objective.assemble import pattern_of
from manireg._objective.hessian import exact, gauss_newton
from manireg._objective.objective import objective
from manireg._solver.linear import direct_solvers
from manireg._solver.minimise import gauge, stage_of
from manireg._solver.starts import free_solution

from .problems import Setup

REPEATS = 5


class Row(NamedTuple):
    stage: str
    seconds: float
    size: int
    """Bytes read and written, once."""
    floor: float
    """Seconds: of the factorisation alone, or of the bytes at the bandwidth."""


class Profile(NamedTuple):
    rows: list[Row]
    compile: float
    """Seconds of the first `solve` beyond those of the next."""
    iteration: float
    """Value, gradient, matrix, factorisation."""
    factorisation: float
    """Of sparsax on the same matrix."""


def profile(setup: Setup) -> Profile:
    problem, lam = setup.problem(), setup.lam
    solvers = direct_solvers(problem, "sparse")
    w = eqx.filter_jit(free_solution)(problem, lam, solvers)
    args = stage_of(problem, jnp.asarray(lam), gauge(problem), "projected", w)

    where = setup.source, setup.centres, problem.x, setup.graded
    domain = discretise(*where)
    parts = domain.geodesics(2), 2
    gradient = eqx.filter_jit(eqx.filter_value_and_grad(objective, has_aux=True))
    assembly, second = eqx.filter_jit(gauss_newton), eqx.filter_jit(exact)

    matrix = assembly(w, args)
    jets = _size((problem.energy_jets, problem.data_jets))
    places = _size((problem.energy_places, problem.data_places))
    bandwidth = _bandwidth()
    iteration, factorisation = newton_iteration(w, args, REPEATS)

    fit = lambda: mr.solve(problem, lam, throw=False, rtol=1e-4, starts=(1.0,))
    first, again = first_and_best(fit, 2)
    steps = int(fit().stats["num_newton_steps"])

    rows = []
    for stage, call, size in (
        (
            "quadrature and centres",
            lambda _: (discretise(*where), centres_of(*where)),
            _size(problem.x),
        ),
        ("jets", lambda _: jets_of(problem.basis, *parts), _size(problem.energy_jets)),
        (
            "sparsity pattern",
            lambda _: pattern_of(problem.basis, problem.energy_jets, problem.data_jets),
            _size(problem.pattern),
        ),
        ("value and gradient", lambda f: gradient(w * f, args), 2 * jets),
        (
            "assembly, Gauss-Newton",
            lambda f: assembly(w * f, args),
            jets + places + _size(matrix),
        ),
        ("exact second derivatives", lambda f: second(w * f, args), jets),
    ):
        rows.append(Row(stage, best(call, REPEATS), size, size / bandwidth))
    rows += [
        Row("factor and solve, CHOLMOD", factorisation, _size(matrix), factorisation),
        Row("a Newton iteration", iteration, 3 * jets + places, factorisation),
        Row(f"the fit, {steps} iterations", again, 0, steps * factorisation),
    ]
    return Profile(rows, first - again, iteration, factorisation)


def _size(tree) -> int:
    return sum(leaf.nbytes for leaf in jax.tree.leaves(eqx.filter(tree, eqx.is_array)))


def _bandwidth() -> float:
    """Bytes a second of a copy that no cache holds, read and written."""
    block = np.ones(2**25)
    return 2 * block.nbytes / first_and_best(block.copy, 3)[1]
