"""The sparse Hessian of the objective, element by element.

E(w) = sum_q weight_q phi(A_q w), so its Hessian is sum_q A_q^T (weight_q D^2 phi) A_q.
`gauss_newton` replaces D^2 phi by 2 R^T R, R the Jacobian of the residuals through
projector and projection: always positive semidefinite. `exact` differentiates twice.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._densities import geodesic_loss, off_manifold_residual, project_flat
from ._jets import jet_values
from ._objective import (
    Stage,
    at_data,
    at_quadrature,
    data_weights,
    energy_residual,
)
from ._sparse import Scatter, SparseSymmetric, scatter_add

VALUE = np.array([0])  # the row of a jet that the loss sees


def gauss_newton(w: Float[Array, "KC t"], stage: Stage) -> SparseSymmetric:
    """The loss contributes 2 Dpi^T Dpi: exact for a perfect fit, and where N is positively
    curved never below the true Hessian."""

    def residuals(target, jet):
        energy = jnp.sqrt(stage.lam) * energy_residual(stage, target, jet)
        off = jnp.sqrt(stage.gamma) * off_manifold_residual(target, jet[0])
        return jnp.concatenate([energy.ravel(), off])

    def gram(f, jets, rows):
        factor = _derivatives(f, jets, rows)
        return 2.0 * jnp.einsum("aepr,bepr->epab", factor, factor)

    landed = lambda target, jet: project_flat(target, jet[0])
    energy, data = stage.problem.energy_jets, stage.problem.data_jets
    return _assemble(
        stage,
        gram(
            lambda j: at_quadrature(stage, residuals, j),
            jet_values(energy, w),
            _rows(stage),
        ),
        gram(lambda j: at_data(stage, landed, j), jet_values(data, w), VALUE),
    )


def exact(w: Float[Array, "KC t"], stage: Stage) -> SparseSymmetric:
    """May be indefinite, away from a minimum: not for Cholesky."""

    def density(target, jet):
        off = off_manifold_residual(target, jet[0])
        energy = energy_residual(stage, target, jet)
        return stage.lam * jnp.sum(energy**2) + stage.gamma * jnp.sum(off**2)

    def loss(target, jet, y):
        return geodesic_loss(target, jet[0], y)

    def hessian(values, jets, rows):
        gradient = jax.grad(lambda jets: jnp.sum(values(jets)))
        columns = _derivatives(lambda jets: gradient(jets)[:, :, rows], jets, rows)
        return jnp.moveaxis(columns.reshape(*columns.shape[:3], -1), 0, 2)

    energy, data = stage.problem.energy_jets, stage.problem.data_jets
    y = stage.problem.y[data.index]
    return _assemble(
        stage,
        hessian(
            lambda j: at_quadrature(stage, density, j),
            jet_values(energy, w),
            _rows(stage),
        ),
        hessian(lambda j: at_data(stage, loss, j, y), jet_values(data, w), VALUE),
    )


def _derivatives(f, jets: Float[Array, "e p J t"], rows) -> Float[Array, "jt e p ..."]:
    """Derivative of `f` along each direction of the given rows, of all jets at once. A
    loop over directions: vmap over them too runs four to six times slower on a CPU."""
    J, t = jets.shape[2:]

    def along(direction):
        return jax.jvp(f, (jets,), (jnp.broadcast_to(direction, jets.shape),))[1]

    directions = jnp.eye(J * t).reshape(J, t, J, t)[rows]
    return jax.lax.map(along, directions.reshape(-1, J, t))


def _rows(stage: Stage) -> np.ndarray:
    """Of a jet, those the energy sees: no first derivatives in the penalised one."""
    m = stage.problem.basis.dim
    rows = np.arange(stage.problem.energy_jets.matrices.shape[2])
    return rows if stage.projected else np.delete(rows, np.arange(1, 1 + m))


def _assemble(
    stage: Stage, energy: Float[Array, "e p Jt Jt"], data: Float[Array, "d r t t"]
) -> SparseSymmetric:
    problem, t = stage.problem, stage.problem.y.shape[1]
    blocks = jnp.zeros((len(problem.pattern.rows), t, t))
    energy = energy * problem.energy_weights[:, :, None, None]
    data = data * data_weights(problem)[:, :, None, None]
    for local, jets, rows, scatters in (
        (energy, problem.energy_jets, _rows(stage), problem.energy_scatters),
        (data, problem.data_jets, VALUE, problem.data_scatters),
    ):
        for (start, stop, U), scatter in zip(jets.buckets, scatters, strict=True):
            matrices = jets.matrices[start:stop, :, rows, :U]
            blocks = _add(blocks, local[start:stop], matrices, scatter)
    return SparseSymmetric(blocks, problem.pattern)


def _add(
    blocks,
    local: Float[Array, "e p Jt Jt"],
    matrices: Float[Array, "e p J U"],
    scatter: Scatter,
):
    """Add A^T local A of all points: one dense product an element, of the t(t+1)/2 pairs
    of components a <= b, then a scatter."""
    t = blocks.shape[-1]
    e, p, J, U = matrices.shape
    a, b = np.triu_indices(t)
    pairs = jnp.moveaxis(local.reshape(e, p, J, t, J, t)[:, :, :, a, :, b], 0, 3)
    terms = [pairs[..., k, None] * matrices[:, :, None, None, k, :] for k in range(J)]
    half = functools.reduce(jnp.add, terms).reshape(e, p * J, len(a) * U)
    whole = jnp.einsum("equ,eqv->euv", matrices.reshape(e, p * J, U), half)
    return scatter_add(blocks, scatter, whole.reshape(e, U, len(a), U))
