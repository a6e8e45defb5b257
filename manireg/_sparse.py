"""Sparse symmetric matrices of t x t blocks, with a pattern found once on the host, as a
lineax operator."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
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
    """Index in the pattern; past its end for padding."""


class SparseSymmetric(lx.AbstractLinearOperator):
    """Symmetric operator on arrays `(size, t)`."""

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

    def diagonal(self) -> Float[Array, "size t"]:
        own = jnp.diagonal(self.blocks, axis1=1, axis2=2)
        diagonal_only = self.pattern.rows == self.pattern.cols
        index = jnp.where(diagonal_only, self.pattern.rows, self.pattern.size)
        shape = (self.pattern.size, own.shape[1])
        return jnp.zeros(shape, own.dtype).at[index].set(own, mode="drop")

    def coordinates(self) -> tuple[Int[Array, "nnz t t"], Int[Array, "nnz t t"]]:
        """Row and column of every stored number in the matrix of `as_matrix`."""
        t = self.blocks.shape[-1]
        inside = jnp.arange(t, dtype=self.pattern.rows.dtype)
        i = self.pattern.rows[:, None, None] * t + inside[:, None]
        j = self.pattern.cols[:, None, None] * t + inside[None, :]
        shape = self.blocks.shape
        return jnp.broadcast_to(i, shape), jnp.broadcast_to(j, shape)

    def transpose(self):
        return self

    def in_structure(self):
        shape = (self.pattern.size, self.blocks.shape[-1])
        # as inside a traced function: in a shard_map types carry the mesh
        return jax.eval_shape(lambda: jnp.zeros(shape, self.blocks.dtype))

    def out_structure(self):
        return self.in_structure()


# lineax asks these by singledispatch when a solve is built, differentiated or transposed
lx.is_symmetric.register(SparseSymmetric)(lambda _: True)
for _query in (
    lx.is_diagonal, lx.is_tridiagonal, lx.is_lower_triangular, lx.is_upper_triangular,
    lx.has_unit_diagonal, lx.is_positive_semidefinite, lx.is_negative_semidefinite,
):  # fmt: skip
    _query.register(SparseSymmetric)(lambda _: False)
for _same in (lx.linearise, lx.materialise, lx.conj):
    _same.register(SparseSymmetric)(lambda operator: operator)


def sparsity(families_of_columns: Sequence[Int[Array, "e U"]], size: int):
    """Pattern of a sum of element matrices, each family given by its columns (negative:
    padding). Returns the pattern and a tuple with a `Scatter` for each family. Host."""
    families = []
    for columns in families_of_columns:
        columns = np.asarray(columns, dtype=np.int64)  # ascending, padding last
        e, U = columns.shape
        i, j = np.triu_indices(U)
        keys = columns[:, i] * size + columns[:, j]
        keys[columns[:, j] < 0] = size**2
        take = np.arange(e)[:, None] * U**2 + i * U + j
        families.append((take.ravel(), keys.ravel()))
    diagonal = np.arange(size) * (size + 1)
    entries = np.unique(np.concatenate([*(keys for _, keys in families), diagonal]))
    entries = entries[entries < size**2]
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
    return SparsityPattern(rows, cols, size), tuple(scatters)


def scatter_add(
    blocks: Float[Array, "nnz t t"],
    scatter: Scatter,
    elements: Float[Array, "e U pairs U"],
) -> Float[Array, "nnz t t"]:
    """Add element matrices to the blocks of a pattern; of their components a, b only
    a <= b are given, the others are those of the transposed entry."""
    t = blocks.shape[-1]
    e, U, pairs, _ = elements.shape
    flat = elements.transpose(0, 1, 3, 2).reshape(-1, pairs)
    element, entry = jnp.divmod(scatter.take, U * U)
    mirrored = element * U * U + entry % U * U + entry // U
    both = jnp.concatenate([flat[scatter.take], flat[mirrored]], axis=1)
    a, b = np.triu_indices(t)
    place = np.zeros((t, t), dtype=int)
    place[b, a] = pairs + np.arange(pairs)
    place[a, b] = np.arange(pairs)
    added = blocks.at[scatter.into]
    return added.add(both[:, place], indices_are_sorted=True, mode="drop")
