"""The sparse Hessian of the objective.

E(w) = sum_q weight_q phi(A_q w), so its Hessian is sum_q A_q^T (weight_q D^2 phi) A_q.
`gauss_newton` replaces D^2 phi by 2 R^T R, R the Jacobian of the residuals through
projector and projection: always positive semidefinite, and assembled. `exact`
differentiates twice. On surfaces it is only ever multiplied with vectors: its solver
iterates, with the factor of a Gauss-Newton matrix near by.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jaxtyping import Array, Float

from .._algebra.sparse import SparseSymmetric, declare_symmetric
from .._discretisation.jets import jet_values
from .assembly import VALUE, PointHessians, assembled
from .densities import geodesic_loss, project_flat
from .objective import (
    Stage,
    at_points,
    data_weights,
    densities,
    residuals,
    strengths,
)
from .problem import Problem, psi_jets

CHUNK_POINTS = 768  # differentiated at a time


class ExactHessian(lx.AbstractLinearOperator):
    """Assembled on demand only: its product sum_q A_q^T (weight_q D^2 phi) A_q v with a
    vector is as quick as a gradient."""

    problem: Problem
    local: PointHessians
    rows: tuple[int, ...] = eqx.field(static=True)
    """Of a jet, those in `local.energy`."""
    model: SparseSymmetric | None
    """A positive definite operator near it."""

    def mv(self, vector):
        families = (
            (self.problem.energy_jets, np.array(self.rows), self.local.energy),
            (self.problem.data_jets, VALUE, self.local.data),
        )
        product = jnp.zeros_like(vector)
        for jets, rows, local in families:
            jet, pull = jax.vjp(lambda v: jet_values(jets, v)[:, :, rows], vector)
            bent = jnp.einsum("epij,epj->epi", local, jet.reshape(local.shape[:-1]))
            product += pull(bent.reshape(jet.shape))[0]
        return product

    def assembled(self) -> SparseSymmetric:
        return assembled(self.problem, self.local, np.array(self.rows))

    def as_matrix(self):
        return self.assembled().as_matrix()

    def transpose(self):
        return self

    def in_structure(self):
        shape = (self.problem.pattern.size, self.local.data.shape[-1])
        return jax.eval_shape(lambda: jnp.zeros(shape, self.local.data.dtype))

    def out_structure(self):
        return self.in_structure()


declare_symmetric(ExactHessian)


def gauss_newton(w: Float[Array, "KC t"], stage: Stage) -> SparseSymmetric:
    """The loss contributes 2 Dpi^T Dpi: exact for a perfect fit, and where N is positively
    curved never below the true Hessian."""

    def weighted(target, jet, *strength):
        energy, off = residuals(stage, target, jet, *strength)
        energy, off = jnp.sqrt(stage.lam) * energy, jnp.sqrt(stage.gamma) * off
        return jnp.concatenate([energy.ravel(), off])

    def landed(target, jet):
        return project_flat(target, jet[0])

    def gram(f, rows):
        def of_element(targets, jets, *strength):
            values = lambda jets: at_points(stage, f, targets, jets, *strength)
            # a loop over the residuals: einsum makes a small product of every point's
            columns = jnp.moveaxis(_derivatives(values, jets, rows), 2, 0)
            squares = [column[:, None] * column for column in columns]
            return 2.0 * functools.reduce(jnp.add, squares).transpose(2, 0, 1)

        return of_element

    problem, rows, local = stage.problem, _rows(stage), stage.local
    jets = [psi_jets(problem, j, w) for j in (problem.energy_jets, problem.data_jets)]
    energy = _each_element(
        gram(weighted, rows),
        local and local.at_quadrature,
        jets[0],
        *strengths(problem),
    )
    data = _each_element(gram(landed, VALUE), local and local.at_data, jets[1])
    return assembled(problem, _weighted(problem, energy, data), rows)


def exact(
    w: Float[Array, "KC t"], stage: Stage, model: SparseSymmetric | None = None
) -> ExactHessian:
    """May be indefinite, away from a minimum. `model`: of `gauss_newton`, at a map near
    by; iterative solvers need it."""

    def density(target, jet, *strength):
        bending, gap = densities(stage, target, jet, *strength)
        return stage.lam * bending + stage.gamma * gap

    def loss(target, jet, y):
        return geodesic_loss(target, jet[0], y)

    def hessian(f, rows):
        def of_element(targets, jets, *others):
            values = lambda jets: jnp.sum(at_points(stage, f, targets, jets, *others))
            columns = _derivatives(lambda j: jax.grad(values)(j)[:, rows], jets, rows)
            return jnp.moveaxis(columns.reshape(*columns.shape[:2], -1), 0, 1)

        return of_element

    problem, rows, local = stage.problem, _rows(stage), stage.local
    jets = [psi_jets(problem, j, w) for j in (problem.energy_jets, problem.data_jets)]
    y = problem.y[problem.data_jets.index]
    energy = _each_element(
        hessian(density, rows),
        local and local.at_quadrature,
        jets[0],
        *strengths(problem),
    )
    data = _each_element(hessian(loss, VALUE), local and local.at_data, jets[1], y)
    if model is not None:
        # a pattern carried through a loop would be batched under vmap
        model = SparseSymmetric(model.blocks, problem.pattern)
    return ExactHessian(
        problem, _weighted(problem, energy, data), tuple(rows.tolist()), model
    )


def _each_element(f, targets, *arrays: Float[Array, "e p ..."]):
    """`f` of every element, so many at a time that what it passes through stays in the
    cache (measured: all at once takes three to four times as long)."""
    e, p = arrays[0].shape[:2]
    size = min(2 ** int(np.log2(max(CHUNK_POINTS / p, 1))), e)
    return jax.lax.map(lambda a: f(*a), (targets, *arrays), batch_size=size)


def _derivatives(f, jets: Float[Array, "p J t"], rows) -> Float[Array, "jt p ..."]:
    """Derivative of `f` along each direction of the given rows, of all jets at once. A
    loop over directions: vmap over them too runs four to six times slower on a CPU."""
    J, t = jets.shape[1:]

    def along(direction):
        return jax.jvp(f, (jets,), (jnp.broadcast_to(direction, jets.shape),))[1]

    directions = jnp.eye(J * t).reshape(J, t, J, t)[rows]
    return jax.lax.map(along, directions.reshape(-1, J, t))


def _rows(stage: Stage) -> np.ndarray:
    """Of a jet, those the energy sees: no first derivatives in the penalised one, unless
    there is tension."""
    m = stage.problem.basis.dim
    rows = np.arange(stage.problem.energy_jets.matrices.shape[2])
    first = stage.projected or stage.problem.tension is not None
    return rows if first else np.delete(rows, np.arange(1, 1 + m))


def _weighted(problem: Problem, energy, data) -> PointHessians:
    return PointHessians(
        energy * problem.energy_weights[:, :, None, None],
        data * data_weights(problem)[:, :, None, None],
    )
