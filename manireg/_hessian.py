"""The sparse Hessian of the objective, element by element.

E(w) = sum_q weight_q phi(A_q w), so its Hessian is sum_q A_q^T (weight_q D^2 phi) A_q.
`gauss_newton` replaces D^2 phi by 2 R^T R, R the Jacobian of the residuals through
projector and projection: always positive semidefinite. `exact` differentiates twice.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._densities import geodesic_loss, loss_factor, off_manifold_residual
from ._jets import jet_values
from ._objective import Stage, data_weights, energy_residual
from ._problem import Problem
from ._sparse import SparseSymmetric, scatter_add


def gauss_newton(w: Float[Array, "KC t"], stage: Stage) -> SparseSymmetric:
    problem = stage.problem

    def density(jet, weight):
        def residuals(jet):
            energy = jnp.sqrt(stage.lam) * energy_residual(stage, jet)
            off = jnp.sqrt(stage.gamma) * off_manifold_residual(problem.target, jet[0])
            return jnp.concatenate([energy.ravel(), off])

        return weight * _gram(jax.jacfwd(residuals)(jet))

    def loss(jet, _, weight):
        return weight * _gram(loss_factor(problem.target, jet[0])[:, None, :])

    return _assemble(w, problem, density, loss)


def exact(w: Float[Array, "KC t"], stage: Stage) -> SparseSymmetric:
    """May be indefinite, away from a minimum: not for Cholesky."""
    problem = stage.problem

    def density(jet, weight):
        off = off_manifold_residual(problem.target, jet[0])
        energy = energy_residual(stage, jet)
        return weight * (stage.lam * jnp.sum(energy**2) + stage.gamma * jnp.sum(off**2))

    def loss(jet, y, weight):
        return weight * geodesic_loss(problem.target, jet[0], y)

    return _assemble(w, problem, jax.hessian(density), jax.hessian(loss))


def _gram(factor: Float[Array, "r J t"]) -> Float[Array, "J t J t"]:
    return 2.0 * jnp.einsum("rjs,rkt->jskt", factor, factor)


def _assemble(w: Float[Array, "KC t"], problem: Problem, density, loss):
    """`density(jet, weight)` and `loss(jet, y, weight)` give blocks `(J, t, J, t)`."""
    pointwise = lambda f: jax.vmap(jax.vmap(f))
    energy_jets, data_jets = problem.energy_jets, problem.data_jets
    at_quadrature = pointwise(density)(
        jet_values(energy_jets, w), problem.energy_weights
    )
    at_data = pointwise(loss)(
        jet_values(data_jets, w), problem.y[data_jets.index], data_weights(problem)
    )
    t = w.shape[1]
    blocks = jnp.zeros((len(problem.pattern.rows), t, t))
    for local, jets, scatter in (
        (at_quadrature, energy_jets, problem.energy_scatter),
        (at_data, data_jets, problem.data_scatter),
    ):
        blocks = scatter_add(blocks, scatter, _sandwich(local, jets.matrices))
    return SparseSymmetric(blocks, problem.pattern)


def _sandwich(
    local: Float[Array, "e p J t J t"], matrices: Float[Array, "e p J U"]
) -> Float[Array, "e U t U t"]:
    """A^T local A, summed over the points of each element: one dense product each."""
    e, p, J, t = local.shape[:4]
    U = matrices.shape[-1]
    half = sum(
        local[:, :, :, :, k, None, :] * matrices[:, :, None, None, k, :, None]
        for k in range(J)
    )
    half = half.reshape(e, p * J, t * U * t)
    whole = jnp.einsum("equ,eqv->euv", matrices.reshape(e, p * J, U), half)
    return whole.reshape(e, U, t, U, t)
