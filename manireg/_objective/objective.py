"""The objective: data, and one function of the coefficients.

    E(w) = sum_q weight_q phi(A_q w) + sum_i weight_i d^2(y_i, pi(B_i w)) / sum_i weight_i
    phi  = lam |energy residual|^2 + gamma |Psi - pi(Psi)|^2

A_q, B_i are the jets (fixed, sparse, linear); phi and the loss are the pointwise
densities. Value, gradient (autodiff) and Hessian (`_hessian`) all read from here.
"""

import functools
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, ScalarLike

from ..manifolds import AbstractManifold
from .densities import (
    Jet,
    geodesic_loss,
    off_manifold_residual,
    penalised_residual,
    projected_residual,
    tension_residual,
)
from .patches import LocalTarget
from .problem import Problem, psi_jets


class Stage(eqx.Module):
    """What stays fixed during one Newton solve: the `args` of the objective."""

    problem: Problem
    lam: ScalarLike
    gamma: ScalarLike
    projected: bool = eqx.field(static=True)
    """Energy of pi o Psi (True) or of Psi near N (False)."""
    local: LocalTarget | None = None
    """What a point cloud is near the map; None: the target itself, everywhere."""


class Energies(eqx.Module):
    """The parts of the objective at a solution."""

    loss: Float[Array, ""]
    """(Weighted) mean squared geodesic error on the data."""
    eells: Float[Array, ""]
    """S, the Eells energy (with the tension's, if there is one)."""
    off_manifold: Float[Array, ""]
    """Largest distance of Psi to N, before the final projection."""


def energy_residual(
    stage: Stage,
    target: AbstractManifold,
    jet: Jet,
    strength: Float[Array, ""] | None = None,
) -> Float[Array, "r t"]:
    """`strength`: of the tension, if there is one (see `strengths`)."""
    residual = projected_residual if stage.projected else penalised_residual
    bending = residual(target, jet, stage.problem.basis.dim)
    tension = stage.problem.tension
    if tension is None or strength is None:
        return bending
    stretching = tension_residual(target, jet, strength, tension.derivative)
    return jnp.concatenate([bending, stretching])


def residuals(
    stage: Stage,
    target: AbstractManifold,
    jet: Float[Array, "J t"],
    *strength: Float[Array, ""],
) -> tuple[Float[Array, "r t"], Float[Array, " t"]]:
    """Those of the energy, and Psi - pi(Psi), at a quadrature point."""
    rows = jnp.unstack(jet)
    energy = energy_residual(stage, target, rows, *strength)
    return energy, off_manifold_residual(target, rows[0])


def densities(
    stage: Stage,
    target: AbstractManifold,
    jet: Float[Array, "J t"],
    *strength: Float[Array, ""],
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """The squares of both `residuals`."""
    energy, off = residuals(stage, target, jet, *strength)
    return jnp.sum(energy**2), jnp.sum(off**2)


def strengths(problem: Problem) -> tuple[Float[Array, "e p"], ...]:
    """What `residuals` take beside the jets, at every quadrature point."""
    return () if problem.tension is None else (problem.tension.strength,)


def at_quadrature(stage: Stage, f: Callable, *arrays: Float[Array, "e p ..."]):
    """`f(target, *arrays)` at every quadrature point."""
    return _at_all(stage, f, stage.local and stage.local.at_quadrature, arrays)


def at_data(stage: Stage, f: Callable, *arrays: Float[Array, "e p ..."]):
    """`f(target, *arrays)` at every datum."""
    return _at_all(stage, f, stage.local and stage.local.at_data, arrays)


def _at_all(stage, f, targets, arrays):
    return jax.vmap(functools.partial(at_points, stage, f))(targets, *arrays)


def at_points(stage: Stage, f: Callable, targets, *arrays: Float[Array, "p ..."]):
    """`f(target, *arrays)` at every point of an element. `targets`: a patch for each, or
    None for the target itself."""
    if targets is None:
        return jax.vmap(functools.partial(f, stage.problem.target))(*arrays)
    return jax.vmap(f)(targets, *arrays)


def data_weights(problem: Problem) -> Float[Array, "e p"]:
    """weight_i / sum_j weight_j, arranged in the elements of the data jets."""
    share = problem.weights / jnp.sum(problem.weights)
    return share[problem.data_jets.index] * problem.data_jets.mask


def objective(
    w: Float[Array, "KC t"], stage: Stage
) -> tuple[Float[Array, ""], Energies]:
    problem = stage.problem
    jets = psi_jets(problem, problem.energy_jets, w)
    both = functools.partial(densities, stage)
    bending, gaps = at_quadrature(stage, both, jets, *strengths(problem))
    eells = jnp.sum(problem.energy_weights * bending)
    penalty = jnp.sum(problem.energy_weights * gaps)

    values = psi_jets(problem, problem.data_jets, w)[:, :, 0]
    y = problem.y[problem.data_jets.index]
    loss = jnp.sum(data_weights(problem) * at_data(stage, geodesic_loss, values, y))

    largest = jnp.max(gaps * problem.energy_jets.mask)
    apart = largest > 0  # the root has no derivative at 0, where flat targets are
    off_manifold = jnp.where(apart, jnp.sqrt(jnp.where(apart, largest, 1.0)), 0.0)
    total = loss + stage.lam * eells + stage.gamma * penalty
    return total, Energies(loss, eells, off_manifold)
