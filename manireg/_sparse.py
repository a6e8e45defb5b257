"""Sparse symmetric matrices of t x t blocks with a pattern known beforehand, as a lineax
operator, and the Cholesky solvers for them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import sparsax
from jaxtyping import Array, Float, Int


class SparsityPattern(eqx.Module):
    """Upper triangle, block by block: rows <= cols, diagonal blocks whole."""

    rows: Int[Array, " nnz"]
    cols: Int[Array, " nnz"]
    size: int = eqx.field(static=True)


class Scatter(eqx.Module):
    """Where the entries of dense element matrices (e, U, U) go in a pattern."""

    take: Int[Array, " kept"]
    """Flat indices of the entries in the upper triangle."""
    into: Int[Array, " kept"]


class SparseSymmetric(lx.AbstractLinearOperator):
    """Symmetric positive semidefinite operator on arrays `(size, t)`."""

    blocks: Float[Array, "nnz t t"]
    pattern: SparsityPattern

    def mv(self, vector):
        rows, cols = self.pattern.rows, self.pattern.cols
        upper = jnp.einsum("nst,nt->ns", self.blocks, vector[cols])
        lower = jnp.einsum("nst,ns->nt", self.blocks, vector[rows])
        lower = jnp.where((rows == cols)[:, None], 0.0, lower)
        return jnp.zeros_like(vector).at[rows].add(upper).at[cols].add(lower)

    def as_matrix(self):
        size, t = self.pattern.size, self.blocks.shape[-1]
        rows, cols = self.pattern.rows, self.pattern.cols
        upper = jnp.zeros((size, size, t, t)).at[rows, cols].set(self.blocks)
        full = upper.at[cols, rows].set(self.blocks.transpose(0, 2, 1))
        return full.transpose(0, 2, 1, 3).reshape(size * t, size * t)

    def transpose(self):
        return self

    def in_structure(self):
        shape = (self.pattern.size, self.blocks.shape[-1])
        return jax.ShapeDtypeStruct(shape, self.blocks.dtype)

    def out_structure(self):
        return self.in_structure()


# lineax asks these by singledispatch when a solve is built, differentiated or transposed
for _query in (lx.is_symmetric, lx.is_positive_semidefinite):
    _query.register(SparseSymmetric)(lambda _: True)
for _query in (
    lx.is_diagonal, lx.is_tridiagonal, lx.is_lower_triangular, lx.is_upper_triangular,
    lx.has_unit_diagonal, lx.is_negative_semidefinite,
):  # fmt: skip
    _query.register(SparseSymmetric)(lambda _: False)
for _same in (lx.linearise, lx.materialise, lx.conj):
    _same.register(SparseSymmetric)(lambda operator: operator)


def sparsity(families_of_columns: list[Int[Array, "e U"]], size: int):
    """Pattern of a sum of element matrices, each family given by its columns (negative:
    padding). Returns the pattern and a `Scatter` for each family. Host."""
    families = []
    for columns in families_of_columns:
        columns = np.asarray(columns, dtype=np.int64)
        keys = columns[:, :, None] * size + columns[:, None, :]
        keep = (columns >= 0)[:, :, None] & (columns[:, :, None] <= columns[:, None, :])
        take = np.flatnonzero(keep)
        families.append((take, keys.ravel()[take]))
    diagonal = np.arange(size) * (size + 1)
    entries = np.unique(np.concatenate([*(keys for _, keys in families), diagonal]))
    rows, cols = (jnp.asarray(a, dtype=jnp.int32) for a in np.divmod(entries, size))
    scatters = []
    for take, keys in families:
        into = np.searchsorted(entries, keys)
        order = np.argsort(into, kind="stable")
        scatters.append(
            Scatter(
                jnp.asarray(take[order], dtype=jnp.int32),
                jnp.asarray(into[order], dtype=jnp.int32),
            )
        )
    return SparsityPattern(rows, cols, size), scatters


def scatter_add(
    blocks: Float[Array, "nnz t t"], scatter: Scatter, elements: Float[Array, "e U t U t"]
) -> Float[Array, "nnz t t"]:
    """Add element matrices to the blocks of a pattern."""
    t = elements.shape[-1]
    flat = elements.transpose(0, 1, 3, 2, 4).reshape(-1, t, t)
    return blocks.at[scatter.into].add(flat[scatter.take], indices_are_sorted=True)


class _AbstractCholesky(lx.AbstractLinearSolver):
    """Cholesky of D^{-1/2} A D^{-1/2} + ridge I with D the diagonal: the ridge moves only
    directions that the objective cannot see (gauge of the basis)."""

    ridge: eqx.AbstractVar[float]

    def transpose(self, state, options):
        return state, options

    def conj(self, state, options):
        return state, options

    def assume_full_rank(self):
        return True


def _scale(operator: SparseSymmetric):
    """D^{-1/2} of the diagonal, and the blocks of D^{-1/2} A D^{-1/2} + ridge I."""
    rows, cols = operator.pattern.rows, operator.pattern.cols
    t = operator.blocks.shape[-1]
    on_diagonal = rows == cols
    own = jnp.diagonal(operator.blocks, axis1=1, axis2=2)
    index = jnp.where(on_diagonal, rows, operator.pattern.size)
    diagonal = jnp.zeros((operator.pattern.size, t)).at[index].set(own, mode="drop")
    floor = 1e-14 * jnp.max(diagonal)
    return jax.lax.rsqrt(jnp.maximum(diagonal, floor)), on_diagonal


class SparseCholesky(_AbstractCholesky):
    """CHOLMOD through sparsax: the symbolic analysis is cached per pattern."""

    ridge: float = 1e-10

    def init(self, operator, options):
        del options
        scale, on_diagonal = _scale(operator)
        rows, cols = operator.pattern.rows, operator.pattern.cols
        t = operator.blocks.shape[-1]
        blocks = operator.blocks * scale[rows][:, :, None] * scale[cols][:, None, :]
        blocks += self.ridge * on_diagonal[:, None, None] * jnp.eye(t)
        inside = jnp.arange(t, dtype=rows.dtype)
        i = rows[:, None, None] * t + inside[:, None]
        j = cols[:, None, None] * t + inside[None, :]
        shape = blocks.shape
        return (
            jnp.broadcast_to(i, shape).ravel(),
            jnp.broadcast_to(j, shape).ravel(),
            blocks.ravel(),
            scale,
        )

    def compute(self, state, vector, options):
        i, j, values, scale = state
        solution = sparsax.solve(i, j, values, (scale * vector).ravel())
        return scale * solution.reshape(vector.shape), lx.RESULTS.successful, {}


class DenseCholesky(_AbstractCholesky):
    """Dense factorisation: for a GPU, and for small problems."""

    ridge: float = 1e-10

    def init(self, operator, options):
        del options
        scale, _ = _scale(operator)
        flat = scale.ravel()
        matrix = operator.as_matrix() * flat[:, None] * flat[None, :]
        matrix += self.ridge * jnp.eye(len(flat))
        return jnp.linalg.cholesky(matrix), scale

    def compute(self, state, vector, options):
        factor, scale = state
        rhs = (scale * vector).ravel()
        solution = jax.scipy.linalg.cho_solve((factor, True), rhs)
        return scale * solution.reshape(vector.shape), lx.RESULTS.successful, {}
