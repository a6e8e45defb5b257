"""One Newton solve, and what it ends in."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import optimistix as optx
from jaxtyping import Array, Float, ScalarLike

from .._algebra.sparse import SparseSymmetric
from .._objective.objective import Energies, objective
from .._objective.sites import Stage
from .newton import Newton


class Minimum(NamedTuple):
    """Where a minimisation ended."""

    w: Float[Array, "KC t"]
    gamma: ScalarLike
    """Of the stage in which it ended."""
    objective: Float[Array, ""]
    energies: Energies
    result: optx.RESULTS
    stats: dict[str, Any]
    model: SparseSymmetric
    """Of the Hessian, there if `newton.keep_model`, else at some point near."""


def newton_solve(newton: Newton, stage: Stage, w: Float[Array, "KC t"]) -> Minimum:
    solution = optx.minimise(
        objective, newton, w, stage, has_aux=True, max_steps=None, throw=False
    )
    stats = dict(solution.stats)
    del stats["max_steps"]
    stats["num_steps"] = stats["num_trials"]
    model, total = stats.pop("model"), stats.pop("objective")
    found = solution.value, stage.gamma, total, solution.aux, solution.result
    return Minimum(*found, stats, model)


def nothing(solve: Callable[..., Minimum], *args) -> Minimum:
    """What `solve(*args)` will give, of zeros: a loop that starts with it has one copy of
    the solve in its program."""
    shapes = eqx.filter_eval_shape(solve, *args)
    is_shape = lambda a: isinstance(a, jax.ShapeDtypeStruct)
    zeros = lambda a: jnp.zeros(a.shape, a.dtype) if is_shape(a) else a
    return jtu.tree_map(zeros, shapes, is_leaf=is_shape)
