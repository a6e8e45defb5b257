"""One Newton solve as a compiled program: that of every fit whose numbers are known, at a
given lambda, along a path or to the end, so it is compiled once."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, ScalarLike

from .._objective.problem import Problem
from .._programs.program import program
from .leverages import left_out_errors
from .linear import AbstractSolvers
from .minimise import Method, minimise, newton_minimiser, stage_of
from .minimum import Minimum


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
) -> tuple[Minimum, Float[Array, " size"]]:
    """The minimum next to `w` of an `argument(problem)`, without its model of the Hessian,
    and with `scored` the errors of the data left out, else zeros."""
    limits, scored = jax.tree.map(np.asarray, (tuple(limits), scored))
    return _fitted(problem, lam, w, limits, scored, method, solvers)


@program(most=16)
def _fitted(problem, lam, w, limits, scored, method, solvers) -> Any:
    rtol, max_steps, certify = limits
    newton = newton_minimiser(
        solvers, rtol, max_steps, certify=certify, keep_model=scored
    )
    found = minimise(problem, lam, w, method, newton)

    def errors():
        stage = stage_of(problem, lam, found.gamma, method, found.w)
        assert found.model is not None
        return left_out_errors(found.w, stage, found.model, solvers)

    nothing = lambda: jnp.zeros(len(problem.y))
    return found._replace(model=None), jax.lax.cond(scored, errors, nothing)
