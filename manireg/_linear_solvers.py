"""Direct solvers for the sparse Hessian: CHOLMOD and KLU through sparsax on the CPU, dense
factorisations for a GPU and for checks. Each is a lineax solver of its own.

All scale the matrix to unit diagonal, D^{-1/2} A D^{-1/2}; the Cholesky ones then add
`ridge`. It moves only directions the objective hardly sees (the gauge of the basis), and
it is a term of the Newton step, not of the objective: the minimiser stays where it is.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import sparsax
from jaxtyping import Array, Float

from ._sparse import SparseSymmetric


class _AbstractDirect(lx.AbstractLinearSolver):
    def transpose(self, state, options):
        return state, options

    def conj(self, state, options):
        return state, options

    def assume_full_rank(self):
        return True


class SparseCholesky(_AbstractDirect):
    """CHOLMOD; the symbolic analysis is cached per pattern. The operator has to be
    positive definite up to `ridge`: sparsax raises otherwise."""

    ridge: float = 1e-12

    def init(self, operator, options):
        del options
        operator = _sparse(operator)
        scale = _scale(operator)
        i, j = operator.coordinates()
        identity = jnp.eye(operator.blocks.shape[-1]) * _on_diagonal(operator)
        values = _scaled_blocks(operator, scale) + self.ridge * identity
        return i.ravel(), j.ravel(), values.ravel(), scale

    def compute(self, state, vector, options):
        i, j, values, scale = state
        solution = sparsax.solve(i, j, values, _flat(scale, vector))
        return _unflat(scale, vector, solution), lx.RESULTS.successful, {}


class SparseLU(_AbstractDirect):
    """KLU, for a symmetric operator that may be indefinite (the exact Hessian)."""

    def init(self, operator, options):
        del options
        operator = _sparse(operator)
        scale = _scale(operator)
        i, j = operator.coordinates()
        values = _scaled_blocks(operator, scale)
        below = jnp.where(_on_diagonal(operator), 0.0, values)
        coordinates = [jnp.stack([i, j]).ravel(), jnp.stack([j, i]).ravel()]
        return *coordinates, jnp.stack([values, below]).ravel(), scale

    def compute(self, state, vector, options):
        i, j, values, scale = state
        solution = sparsax.lu_solve(i, j, values, _flat(scale, vector))
        return _unflat(scale, vector, solution), lx.RESULTS.successful, {}


class DenseCholesky(_AbstractDirect):
    ridge: float = 1e-12

    def init(self, operator, options):
        del options
        matrix, scale = _dense(_sparse(operator))
        return jnp.linalg.cholesky(matrix + self.ridge * jnp.eye(len(matrix))), scale

    def compute(self, state, vector, options):
        factor, scale = state
        solution = jax.scipy.linalg.cho_solve((factor, True), _flat(scale, vector))
        return _unflat(scale, vector, solution), lx.RESULTS.successful, {}


class DenseLU(_AbstractDirect):
    def init(self, operator, options):
        del options
        matrix, scale = _dense(_sparse(operator))
        return jax.scipy.linalg.lu_factor(matrix), scale

    def compute(self, state, vector, options):
        factor, scale = state
        solution = jax.scipy.linalg.lu_solve(factor, _flat(scale, vector))
        return _unflat(scale, vector, solution), lx.RESULTS.successful, {}


class DirectSolvers(eqx.Module):
    """The pair a Newton solve needs."""

    positive: lx.AbstractLinearSolver
    """For the Gauss-Newton model."""
    indefinite: lx.AbstractLinearSolver
    """For the exact Hessian."""


def direct_solvers(kind: str = "auto") -> DirectSolvers:
    """`"sparse"`, `"dense"`, or `"auto"`: sparse on the CPU, dense elsewhere."""
    if kind == "auto":
        kind = "sparse" if jax.default_backend() == "cpu" else "dense"
    if kind == "sparse":
        return DirectSolvers(SparseCholesky(), SparseLU())
    if kind == "dense":
        return DirectSolvers(DenseCholesky(), DenseLU())
    raise ValueError(
        f"linear_algebra: expected 'auto', 'sparse' or 'dense', found {kind!r}."
    )


def _sparse(operator: lx.AbstractLinearOperator) -> SparseSymmetric:
    if not isinstance(operator, SparseSymmetric):
        raise TypeError(f"expected a SparseSymmetric, found {type(operator).__name__}.")
    return operator


def _scale(operator: SparseSymmetric):
    diagonal = jnp.abs(operator.diagonal())
    return jax.lax.rsqrt(jnp.maximum(diagonal, 1e-14 * jnp.max(diagonal)))


def _flat(scale: Float[Array, "size t"], vector: Float[Array, "size t *sides"]):
    """Scaled right-hand side, or several: `(size t, *sides)`."""
    sides = vector.shape[2:]
    return scale.reshape(-1, *(1 for _ in sides)) * vector.reshape(-1, *sides)


def _unflat(scale, vector, solution):
    sides = vector.shape[2:]
    scaled = scale.reshape(-1, *(1 for _ in sides)) * solution
    return scaled.reshape(vector.shape)


def _scaled_blocks(operator: SparseSymmetric, scale):
    rows, cols = operator.pattern.rows, operator.pattern.cols
    return operator.blocks * scale[rows][:, :, None] * scale[cols][:, None, :]


def _on_diagonal(operator: SparseSymmetric):
    """Diagonal blocks, which are stored whole: both triangles."""
    return (operator.pattern.rows == operator.pattern.cols)[:, None, None]


def _dense(operator: SparseSymmetric):
    scale = _scale(operator)
    flat = scale.ravel()
    return operator.as_matrix() * flat[:, None] * flat[None, :], scale
