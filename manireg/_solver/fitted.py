"""One Newton solve as a compiled program: that of every fit whose numbers are known, at a
given lambda, along a path or to the end, so it is compiled once."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, ScalarLike

from .._objective.arguments import of_data
from .._objective.problem import Problem
from .._programs.program import program
from .leverages import Leverages, leverages, no_leverages
from .linear import AbstractSolvers
from .minimise import Method, minimise, newton_minimiser, stage_of
from .minimum import Minimum

SCORED = 1000  # enough for a mean: its standard error is a thirtieth of the errors' own


class Limits(NamedTuple):
    """Of one Newton solve; see `Newton`."""

    rtol: ScalarLike
    max_steps: ScalarLike
    certify: ScalarLike


def fitted(
    problem: Problem,
    lam: Float[Array, ""],
    w: Float[ArrayLike, "KC t"],
    limits: Limits,
    solvers: AbstractSolvers,
    *,
    method: Method = "projected",
    scored: bool = False,
) -> tuple[Minimum, Leverages]:
    """The minimum next to `w` of an `argument(problem)`, without its model of the Hessian,
    and with `scored` the leverages of the `scored_data`, else zeros."""
    data = scored_data(problem)
    limits, scored = jax.tree.map(np.asarray, (tuple(limits), scored))
    some = asked(problem, data)
    found, seen = _fitted(problem, lam, w, limits, scored, some, method, solvers)
    return found, of_asked(problem, data, seen)


def scored_data(problem: Problem) -> Int[np.ndarray, " n"]:
    """Indices of the data that scores are made of: those of positive weight. On a curve
    all; elsewhere, where each takes solves of its own, not more than `SCORED`, the same at
    every call."""
    heavy = np.flatnonzero(np.asarray(problem.weights) > 0)
    if problem.basis.dim == 1 or len(heavy) <= SCORED:
        return heavy
    return np.sort(np.random.default_rng(0).choice(heavy, SCORED, replace=False))


def asked(problem: Problem, data: Int[np.ndarray, " n"]) -> Any:
    """The `scored` of `leverages`, for these data: None on a curve, where all are."""
    if problem.basis.dim == 1:
        return None
    return of_data(data, len(data)), np.asarray(len(data))


def of_asked(
    problem: Problem, data: Int[np.ndarray, " n"], seen: Leverages
) -> Leverages:
    """Of what programs give, without what fills it up: these data's, as NumPy arrays."""
    own = data if problem.basis.dim == 1 else slice(len(data))
    return Leverages(*(np.asarray(a)[own] for a in seen))


@program(most=8)
def _fitted(problem, lam, w, limits, scored, data, method, solvers) -> Any:
    rtol, max_steps, certify = limits
    newton = newton_minimiser(
        solvers, rtol, max_steps, certify=certify, keep_model=scored
    )
    found = minimise(problem, lam, w, method, newton)

    def seen():
        stage = stage_of(problem, lam, found.gamma, method, found.w)
        assert found.model is not None
        return leverages(found.w, stage, found.model, solvers, data)

    nothing = lambda: no_leverages(problem, len(problem.y if data is None else data[0]))
    return found._replace(model=None), jax.lax.cond(scored, seen, nothing)
