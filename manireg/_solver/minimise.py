"""From start coefficients to a minimiser: on analytic targets one Newton solve (or the
paper's penalty path), on point clouds a few, each on fixed patches."""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float, ScalarLike

from .._discretisation.partial_derivatives import rows_of_order
from .._objective.patches import moved, patches_near
from .._objective.problem import Problem
from .._objective.sites import Stage
from .linear import AbstractSolvers
from .minimum import Minimum, newton_solve, unsolved
from .newton import Newton, add_counts
from .penalty_path import penalty_path

ROUNDING = 32.0  # times what one rounding of every number in the residuals changes
ROUNDS = 12  # Newton solves on a point cloud, each on the patches of the one before
ROUND_STEPS = 4  # trial steps of each: more are lost when the patches change
# Relative decrease that derivatives of order three and four still tell from rounding.
HIGHER_RTOL = 1e-10
PATCH_RTOL = 1e-3  # relative decrease of the objective at which each stops
SETTLED = 1e-2  # share of patches that may still change at the end

Method = Literal["projected", "penalty"]


def newton_minimiser(
    solvers: AbstractSolvers,
    rtol: ScalarLike,
    max_steps: ScalarLike,
    *,
    certify: ScalarLike = False,
    keep_model: ScalarLike = False,
) -> Newton:
    return Newton(
        rtol=rtol,
        atol=0.0,
        direction=solvers.direction,
        certify=certify,
        keep_model=keep_model,
        max_trials=max_steps,
    )


def gauge(problem: Problem) -> Float[Array, ""]:
    """gamma of a solve in one stage."""
    return problem.energy.gauge / problem.volume


def stage_of(problem: Problem, lam, gamma, method: Method, w) -> Stage:
    """The objective near the map with coefficients `w`."""
    energy = problem.energy
    energy = energy.penalised() if method == "penalty" else energy
    return Stage(problem, lam, gamma, energy, patches_near(problem, w))


def projected_stage(problem: Problem, lam, w, stiff: float = 1.0) -> Stage:
    """That of the last solve; `stiff`: times its gauge."""
    return stage_of(problem, lam, stiff * gauge(problem), "projected", w)


def minimise(
    problem: Problem,
    lam,
    w0: Float[Array, "KC t"],
    method: Method,
    newton: Newton,
) -> Minimum:
    noise = ROUNDING * jnp.finfo(w0.dtype).eps * _residual_terms(problem, lam, w0)
    rtol = newton.rtol
    if problem.energy.order > 2:
        rtol = jnp.maximum(rtol, HIGHER_RTOL)
    newton = eqx.tree_at(
        lambda n: (n.rtol, n.atol, n.noise),
        newton,
        (rtol, newton.atol + noise**2, noise),
    )
    stage = stage_of(problem, lam, gauge(problem), method, w0)
    if stage.patches is None:
        if method == "penalty":
            return penalty_path(problem, lam, w0, newton)
        return newton_solve(newton, stage, w0)
    if method == "penalty":
        raise ValueError("method: 'penalty' is for analytic targets; leave it out.")
    # the patches are wrong by more than this, and exact Hessians dear
    coarse = (jnp.maximum(newton.rtol, PATCH_RTOL), 0.0, False)
    newton = eqx.tree_at(lambda n: (n.rtol, n.near, n.certify), newton, coarse)
    return _rounds(newton, stage, w0)


def _residual_terms(problem: Problem, lam, w: Float[Array, "KC t"]):
    """Root mean square of the terms that residuals are sums of: coordinates in the loss,
    in the energy products of coefficients and the highest derivatives of the basis."""
    highest = rows_of_order(problem.basis.dim, problem.energy.order)
    highest = problem.energy_jets.matrices[:, :, highest]
    sums = jnp.sum(jnp.sum(jnp.abs(highest), axis=-1) ** 2, axis=-1)
    energy = lam * jnp.sum(problem.energy_weights * sums) * jnp.max(w**2)
    share = problem.weights / jnp.sum(problem.weights)
    return jnp.sqrt(jnp.sum(share * jnp.sum(problem.y**2, axis=1)) + energy)


def _rounds(newton: Newton, stage: Stage, w0) -> Minimum:
    """Newton solves with the patches renewed in between, until hardly any change, of
    `newton.max_trials` trial steps in all."""
    max_steps = newton.max_trials
    steps = jnp.minimum(ROUND_STEPS, max_steps)
    newton = eqx.tree_at(lambda n: n.max_trials, newton, steps)

    def unfinished(carry):
        rounds, found, _ = carry
        allowed = (rounds < ROUNDS) & (found.stats["num_trials"] + steps <= max_steps)
        unsettled = found.result != optx.RESULTS.successful
        return (rounds == 0) | (allowed & unsettled)

    def next_round(carry):
        rounds, before, patches = carry
        here = eqx.tree_at(lambda s: s.patches, stage, patches)
        found = newton_solve(newton, here, before.w)
        renewed = patches_near(stage.problem, found.w, patches, rounds + 1)
        assert renewed is not None
        done = found.result == optx.RESULTS.successful
        done &= moved(patches, renewed) <= SETTLED
        unsettled = optx.RESULTS.nonlinear_max_steps_reached
        result = optx.RESULTS.where(done, optx.RESULTS.successful, unsettled)
        stats = add_counts(found.stats, before.stats)
        return rounds + 1, found._replace(result=result, stats=stats), renewed

    carry = jnp.array(0), unsolved(stage, w0), stage.patches
    return jax.lax.while_loop(unfinished, next_round, carry)[1]
