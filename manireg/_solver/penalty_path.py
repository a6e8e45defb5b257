"""The paper's penalty path: gamma is raised in stages until Psi has settled on N."""

import jax
import jax.numpy as jnp
import optimistix as optx

from .._objective.objective import Stage, objective
from .._objective.problem import Problem
from .newton import Newton, add_counts

MARGIN = 50.0  # gamma_0 in units of (L + lambda S) / (vol(M) reach^2): smaller ones let
# Psi collapse to the medial axis, where |P D^2 Psi| is small
FACTOR = 10.0  # gamma grows by it; additive steps cost many more Newton steps
STAGES = 8
TOLERANCE = 1e-4  # of the reach: largest distance to N at which the path stops


def penalty_path(problem: Problem, lam, w0, newton: Newton, max_steps: int):
    """Minimise at gamma_0, 10 gamma_0, ... Stops when the largest distance to N is below
    1e-4 of the reach, or no longer halves (the basis cannot follow N more closely; more
    gamma would make the map worse). Returns `(w, gamma, objective, result, stats)`."""
    reach = jnp.minimum(jnp.asarray(problem.target.reach, float), 1e3)
    on_target = Stage(problem, lam, 0.0, True)
    _, start = objective(w0, on_target)
    gamma = MARGIN * (start.loss + lam * start.eells) / (problem.volume * reach**2)

    def minimise(w, gamma):
        stage = Stage(problem, lam, gamma, False)
        solution = optx.minimise(
            objective, newton, w, stage, has_aux=True, max_steps=max_steps, throw=False
        )
        total, energies = objective(solution.value, stage)
        return solution.value, total, energies.off_manifold, solution

    def unfinished(carry):
        stage, _, _, gap, halved, _, result, _ = carry
        go_on = (stage < STAGES) & (gap > TOLERANCE * reach) & halved
        return go_on & (result == optx.RESULTS.successful)

    def next_stage(carry):
        stage, w, gamma, gap, _, _, _, stats = carry
        w, total, new_gap, solution = minimise(w, FACTOR * gamma)
        stats = add_counts(solution.stats, stats)
        halved = new_gap < 0.5 * gap
        return (
            stage + 1,
            w,
            FACTOR * gamma,
            new_gap,
            halved,
            total,
            solution.result,
            stats,
        )

    w, total, gap, solution = minimise(w0, gamma)
    first = (1, w, gamma, gap, True, total, solution.result, solution.stats)
    carry = jax.tree.map(jnp.asarray, first)
    _, w, gamma, _, _, total, result, stats = jax.lax.while_loop(
        unfinished, next_stage, carry
    )
    return w, gamma, total, result, stats
