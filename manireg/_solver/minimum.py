"""One Newton solve, and what it ends in."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, ScalarLike

from .._algebra.sparse import SparseSymmetric
from .._objective.objective import Energies, objective
from .._objective.sites import Stage
from .newton import COUNTS, Newton


class Minimum(NamedTuple):
    """Where a minimisation ended."""

    w: Float[Array, "KC t"]
    gamma: ScalarLike
    """Of the stage in which it ended."""
    objective: Float[Array, ""]
    energies: Energies
    result: optx.RESULTS
    stats: dict[str, Any]
    model: SparseSymmetric | None
    """Of the Hessian, there if `newton.keep_model`, else at some point near."""


def is_successful(result: optx.RESULTS) -> bool:
    """Of one that is known, without compiling a comparison."""
    return int(np.asarray(result._value)) == int(optx.RESULTS.successful._value)


def newton_solve(newton: Newton, stage: Stage, w: Float[Array, "KC t"]) -> Minimum:
    newton = eqx.tree_at(lambda n: n.model, newton, _no_model(stage, w))
    solution = optx.minimise(
        objective, newton, w, stage, has_aux=True, max_steps=None, throw=False
    )
    stats = solution.stats
    stats = {
        "num_newton_steps": stats["num_newton_steps"],
        "num_trials": stats["num_trials"],
        "num_steps": stats["num_trials"],
        "num_rounds": jnp.array(1),
        "decrease": stats["decrease"],
    }
    model, total = solution.stats["model"], solution.stats["objective"]
    found = solution.value, stage.gamma, total, solution.aux, solution.result
    return Minimum(*found, stats, model)


def unsolved(stage: Stage, w: Float[Array, "KC t"]) -> Minimum:
    """Nothing but a start: loops over solves begin with it, and their programs have one
    copy of the solve."""
    _, energies = eqx.filter_eval_shape(objective, w, stage)
    energies = jax.tree.map(lambda a: jnp.zeros(a.shape, a.dtype), energies)
    count, number = jnp.array(0), jnp.zeros((), w.dtype)
    stats = {**dict.fromkeys(COUNTS, count), "decrease": number}
    result = optx.RESULTS.nonlinear_max_steps_reached
    return Minimum(w, number, number, energies, result, stats, _no_model(stage, w))


def _no_model(stage: Stage, w: Float[Array, "KC t"]) -> SparseSymmetric:
    pattern = stage.problem.pattern
    b = pattern.functions * w.shape[1]
    return SparseSymmetric(jnp.zeros((len(pattern.rows), b, b)), pattern)
