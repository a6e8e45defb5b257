"""The objective: data, and one function of the coefficients.

    E(w) = sum_q weight_q phi(A_q w) + sum_i weight_i d^2(y_i, pi(B_i w)) / sum_i weight_i
    phi  = lam |eells residual|^2 + gamma |Psi - pi(Psi)|^2

A_q, B_i are the jets (fixed, sparse, linear); phi and the loss are the pointwise
densities. Value, gradient (autodiff) and Hessian (`_hessian`) all read from here.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, ScalarLike

from ._densities import (
    geodesic_loss,
    off_manifold_residual,
    penalised_residual,
    projected_residual,
)
from ._jets import jet_values
from ._problem import Problem


class Stage(eqx.Module):
    """What stays fixed during one Newton solve: the `args` of the objective."""

    problem: Problem
    lam: ScalarLike
    gamma: ScalarLike
    projected: bool = eqx.field(static=True)
    """Energy of pi o Psi (True) or of Psi near N (False)."""


class Energies(eqx.Module):
    """The parts of the objective at a solution."""

    loss: Float[Array, ""]
    """(Weighted) mean squared geodesic error on the data."""
    eells: Float[Array, ""]
    """S, the Eells energy."""
    off_manifold: Float[Array, ""]
    """Largest distance of Psi to N, before the final projection."""


def energy_residual(stage: Stage, jet: Float[Array, "J t"]) -> Float[Array, "r t"]:
    residual = projected_residual if stage.projected else penalised_residual
    return residual(stage.problem.target, jet, stage.problem.basis.dim)


def data_weights(problem: Problem) -> Float[Array, "e p"]:
    """weight_i / sum_j weight_j, arranged in the elements of the data jets."""
    share = problem.weights / jnp.sum(problem.weights)
    return share[problem.data_jets.index] * problem.data_jets.mask


def objective(
    w: Float[Array, "KC t"], stage: Stage
) -> tuple[Float[Array, ""], Energies]:
    problem = stage.problem
    jets = jet_values(problem.energy_jets, w)
    residuals = jax.vmap(jax.vmap(lambda jet: energy_residual(stage, jet)))(jets)
    eells = jnp.sum(problem.energy_weights * jnp.sum(residuals**2, axis=(2, 3)))

    displacement = lambda psi: off_manifold_residual(problem.target, psi)
    gaps = jnp.sum(jax.vmap(jax.vmap(displacement))(jets[:, :, 0]) ** 2, axis=2)
    penalty = jnp.sum(problem.energy_weights * gaps)

    values = jet_values(problem.data_jets, w)[:, :, 0]
    losses = jax.vmap(jax.vmap(lambda psi, y: geodesic_loss(problem.target, psi, y)))(
        values, problem.y[problem.data_jets.index]
    )
    loss = jnp.sum(data_weights(problem) * losses)

    off_manifold = jnp.sqrt(jnp.max(gaps * problem.energy_jets.mask))
    total = loss + stage.lam * eells + stage.gamma * penalty
    return total, Energies(loss, eells, off_manifold)
