"""One Newton solve, and what it ends in."""

from typing import Any, NamedTuple

import optimistix as optx
from jaxtyping import Array, Float, ScalarLike

from .._objective.objective import objective
from .._objective.sites import Stage
from .newton import Newton


class Minimum(NamedTuple):
    """Where a minimisation ended."""

    w: Float[Array, "KC t"]
    gamma: ScalarLike
    """Of the stage in which it ended."""
    objective: Float[Array, ""]
    result: optx.RESULTS
    stats: dict[str, Any]


def newton_solve(
    newton: Newton, stage: Stage, w: Float[Array, "KC t"], max_steps: int
) -> Minimum:
    solution = optx.minimise(
        objective, newton, w, stage, has_aux=True, max_steps=max_steps, throw=False
    )
    total = solution.stats["objective"]
    return Minimum(solution.value, stage.gamma, total, solution.result, solution.stats)
