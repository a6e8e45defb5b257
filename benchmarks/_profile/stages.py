"""Time and bytes of every stage of a fit, next to the least they could be."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import sparsax
from _timing import first_and_best

import manireg as mr
from manireg._domain import centres_of, discretise
from manireg._hessian import exact, gauss_newton
from manireg._jets import bucket_centres, jets_of
from manireg._linear_solvers import SparseCholesky, direct_solvers
from manireg._minimise import AMBIENT_GAUGE, GAUGE, stage_of
from manireg._objective import objective
from manireg._solve import free_solution
from manireg._sparse import sparsity

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
    gauge = AMBIENT_GAUGE if isinstance(setup.source, mr.Ambient) else GAUGE
    solvers = direct_solvers("sparse", problem.basis.dim)
    w = eqx.filter_jit(free_solution)(problem, lam, solvers)
    args = stage_of(problem, jnp.asarray(lam), gauge / problem.volume, "projected", w)

    # functions of w: CHOLMOD's factor is kept while the values are the same
    gradient = eqx.filter_jit(eqx.filter_value_and_grad(objective, has_aux=True))
    assembly, second = eqx.filter_jit(gauss_newton), eqx.filter_jit(exact)

    @eqx.filter_jit
    def iteration(w, args):
        value = eqx.filter_value_and_grad(objective, has_aux=True)
        _, slope = value(w, args)
        solver = SparseCholesky()
        return solver.compute(solver.init(gauss_newton(w, args), {}), slope, {})[0]

    i, j, values, _ = eqx.filter_jit(
        lambda w, args: SparseCholesky().init(gauss_newton(w, args), {})
    )(w, args)
    factorise = jax.jit(sparsax.solve)

    matrix = assembly(w, args)
    jets = _size((problem.energy_jets, problem.data_jets))
    places = _size((problem.energy_places, problem.data_places))
    bandwidth = _bandwidth()
    bytes_alone = lambda size: size / bandwidth
    factorisation = _best(lambda f: factorise(i, j, values * f, w.ravel()))

    fit = lambda: mr.solve(problem, lam, throw=False, rtol=1e-4, starts=(1.0,))
    first, again = first_and_best(fit, 2)
    steps = int(fit().stats["num_newton_steps"])

    rows = []
    for stage, call, size in (
        ("quadrature and centres", lambda _: _points(setup), _size(problem.x)),
        ("jets", lambda _: _jets(setup, problem), _size(problem.energy_jets)),
        ("sparsity pattern", lambda _: _pattern(problem), _size(problem.pattern)),
        ("value and gradient", lambda f: gradient(w * f, args), 2 * jets),
        (
            "assembly, Gauss-Newton",
            lambda f: assembly(w * f, args),
            jets + places + _size(matrix),
        ),
        ("exact second derivatives", lambda f: second(w * f, args), jets),
    ):
        rows.append(Row(stage, _best(call), size, bytes_alone(size)))
    whole = _best(lambda f: iteration(w * f, args))
    rows += [
        Row("factorisation and solve", factorisation, _size(matrix), factorisation),
        Row("a Newton iteration", whole, 3 * jets + places, factorisation),
        Row(f"the fit, {steps} iterations", again, 0, steps * factorisation),
    ]
    return Profile(rows, first - again, whole, factorisation)


def _best(call: Callable) -> float:
    factors = iter(1 + 1e-7 * np.arange(1, REPEATS + 2))
    return first_and_best(lambda: call(next(factors)), REPEATS)[1]


def _points(setup: Setup):
    arguments = setup.source, setup.centres, jnp.asarray(setup.x), setup.graded
    return discretise(*arguments), centres_of(*arguments)


def _jets(setup: Setup, problem: mr.Problem):
    domain = discretise(setup.source, setup.centres, problem.x, setup.graded)
    return jets_of(problem.basis, domain.points, domain.frames, domain.second_forms)


def _pattern(problem: mr.Problem):
    families = [
        centres
        for jets in (problem.energy_jets, problem.data_jets)
        for centres in bucket_centres(jets, problem.basis.size)
    ]
    supports = np.asarray(problem.basis.centres), np.asarray(problem.basis.widths)
    return sparsity(families, *supports, problem.basis.size)


def _size(tree) -> int:
    return sum(leaf.nbytes for leaf in jax.tree.leaves(eqx.filter(tree, eqx.is_array)))


def _bandwidth() -> float:
    """Bytes a second of a copy that no cache holds, read and written."""
    block = np.ones(2**25)
    return 2 * block.nbytes / first_and_best(block.copy, 3)[1]
