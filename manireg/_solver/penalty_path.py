"""The paper's penalty path: gamma is raised in stages until Psi has settled on N."""

import jax
import jax.numpy as jnp
import optimistix as optx

from .._objective.energies import IntrinsicEnergy
from .._objective.objective import objective
from .._objective.problem import Problem
from .._objective.sites import Stage
from .minimum import Minimum, newton_solve, unsolved
from .newton import Newton, add_counts

MARGIN = 50.0  # gamma_0 in units of (L + lambda S) / (vol(M) reach^2): smaller ones let
# Psi collapse to the medial axis, where |P D^2 Psi| is small
FACTOR = 10.0  # gamma grows by it; additive steps cost many more Newton steps
STAGES = 8
TOLERANCE = 1e-4  # of the reach: largest distance to N at which the path stops


def penalty_path(problem: Problem, lam, w0, newton: Newton) -> Minimum:
    """Minimise at gamma_0, 10 gamma_0, ... Stops when the largest distance to N is below
    1e-4 of the reach, or no longer halves (the basis cannot follow N more closely; more
    gamma would make the map worse)."""
    reach = jnp.minimum(jnp.asarray(problem.target.reach, float), 1e3)
    on_target = Stage(problem, lam, 0.0, IntrinsicEnergy())
    _, start = objective(w0, on_target)
    gamma = MARGIN * (start.loss + lam * start.energy) / (problem.volume * reach**2)

    def minimise(w, gamma):
        stage = Stage(problem, lam, gamma, problem.energy.penalised())
        return newton_solve(newton, stage, w)

    def unfinished(carry):
        stages, found, gap, halved = carry
        go_on = (stages < STAGES) & (gap > TOLERANCE * reach) & halved
        return (stages == 0) | (go_on & (found.result == optx.RESULTS.successful))

    def next_stage(carry):
        stages, before, gap, _ = carry
        found = minimise(before.w, gamma * FACTOR**stages)
        found = found._replace(stats=add_counts(found.stats, before.stats))
        new_gap = found.energies.off_manifold
        return stages + 1, found, new_gap, new_gap < 0.5 * gap

    carry = jnp.array(0), unsolved(on_target, w0), jnp.array(jnp.inf), jnp.array(True)
    return jax.lax.while_loop(unfinished, next_stage, carry)[1]
