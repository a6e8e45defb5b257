"""The sparse Hessian of the objective, element by element.

E(w) = sum_q weight_q phi(A_q w), so its Hessian is sum_q A_q^T (weight_q D^2 phi) A_q.
`gauss_newton` replaces D^2 phi by 2 R^T R, R the Jacobian of the residuals through
projector and projection: always positive semidefinite. `exact` differentiates phi twice.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._densities import geodesic_loss, loss_factor, off_manifold_residual
from ._jets import jet_values
from ._objective import Problem, Stage, data_weights, energy_residual
from ._sparse import SparseSymmetric, scatter_add


def gauss_newton(w: Float[Array, "KC t"], stage: Stage) -> SparseSymmetric:
    problem = stage.problem

    def residuals(jet):
        energy = jnp.sqrt(stage.lam) * energy_residual(stage, jet)
        off = jnp.sqrt(stage.gamma) * off_manifold_residual(problem.target, jet[0])
        return jnp.concatenate([energy.ravel(), off])

    jets = jet_values(problem.energy_jets, w)
    factors = jax.vmap(jax.vmap(jax.jacfwd(residuals)))(jets)
    scale = jnp.sqrt(2.0 * problem.energy_weights)[:, :, None, None, None]
    energy = _square(scale * factors, problem.energy_jets.matrices)

    values = jet_values(problem.data_jets, w)
    factor = lambda psi: loss_factor(problem.target, psi)
    factors = jax.vmap(jax.vmap(factor))(values[:, :, 0])[:, :, :, None]
    scale = jnp.sqrt(2.0 * data_weights(problem))[:, :, None, None, None]
    data = _square(scale * factors, problem.data_jets.matrices)
    return _assemble(problem, energy, data)


def exact(w: Float[Array, "KC t"], stage: Stage) -> SparseSymmetric:
    """May be indefinite, away from a minimum: not for Cholesky."""
    problem = stage.problem

    def density(jet, weight):
        off = off_manifold_residual(problem.target, jet[0])
        energy = energy_residual(stage, jet)
        return weight * (stage.lam * jnp.sum(energy**2) + stage.gamma * jnp.sum(off**2))

    def loss(jet, y, weight):
        return weight * geodesic_loss(problem.target, jet[0], y)

    second = lambda f: jax.vmap(jax.vmap(jax.hessian(f)))
    jets = jet_values(problem.energy_jets, w)
    energy = second(density)(jets, problem.energy_weights)
    values = jet_values(problem.data_jets, w)
    data = second(loss)(values, problem.y[problem.data_jets.index], data_weights(problem))
    return _assemble(
        problem,
        _sandwich(energy, problem.energy_jets.matrices),
        _sandwich(data, problem.data_jets.matrices),
    )


def _square(
    factors: Float[Array, "e p r J t"], matrices: Float[Array, "e p J U"]
) -> Float[Array, "e U t U t"]:
    rows = jnp.einsum("eprjt,epju->eprut", factors, matrices)
    e, p, r, u, t = rows.shape
    rows = rows.reshape(e, p * r, u * t)
    return jnp.einsum("eri,erj->eij", rows, rows).reshape(e, u, t, u, t)


def _sandwich(
    blocks: Float[Array, "e p J t J t"], matrices: Float[Array, "e p J U"]
) -> Float[Array, "e U t U t"]:
    half = jnp.einsum("epjskt,epkv->epjsvt", blocks, matrices)
    return jnp.einsum("epju,epjsvt->eusvt", matrices, half)


def _assemble(problem: Problem, energy, data) -> SparseSymmetric:
    t = energy.shape[-1]
    blocks = jnp.zeros((len(problem.pattern.rows), t, t))
    blocks = scatter_add(blocks, problem.energy_scatter, energy)
    blocks = scatter_add(blocks, problem.data_scatter, data)
    return SparseSymmetric(blocks, problem.pattern)
