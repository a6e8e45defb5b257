"""Sparse symmetric matrices of t x t blocks, with a pattern found once on the host, as a
lineax operator."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.spatial import KDTree


class SparsityPattern(eqx.Module):
    """Which pairs of centres interact: rows <= cols, every centre with itself. A block
    holds all unknowns of the two, so there are few indices and each moves much data."""

    rows: Int[Array, " nnz"]
    cols: Int[Array, " nnz"]
    centres: int = eqx.field(static=True)
    functions: int = eqx.field(static=True)
    """Basis functions of each centre."""
    band: int | None = eqx.field(static=True)
    """Interacting centres are less than this apart in order; None but on curves."""

    @property
    def size(self) -> int:
        """Basis functions in all."""
        return self.centres * self.functions


class SparseSymmetric(lx.AbstractLinearOperator):
    """Symmetric operator on arrays `(size, t)`. Blocks have b = functions t rows; those
    on the diagonal are whole, both triangles."""

    blocks: Float[Array, "nnz b b"]
    pattern: SparsityPattern

    @property
    def t(self) -> int:
        return self.blocks.shape[-1] // self.pattern.functions

    def mv(self, vector):
        rows, cols = self.pattern.rows, self.pattern.cols
        by_centre = vector.reshape(self.pattern.centres, -1)
        upper = jnp.einsum("nij,nj->ni", self.blocks, by_centre[cols])
        lower = jnp.einsum("nij,ni->nj", self.blocks, by_centre[rows])
        lower = jnp.where((rows == cols)[:, None], 0.0, lower)
        product = jnp.zeros_like(by_centre).at[rows].add(upper).at[cols].add(lower)
        return product.reshape(vector.shape)

    def as_matrix(self):
        K, b = self.pattern.centres, self.blocks.shape[-1]
        rows, cols = self.pattern.rows, self.pattern.cols
        upper = jnp.zeros((K, K, b, b)).at[rows, cols].set(self.blocks)
        full = upper.at[cols, rows].set(self.blocks.transpose(0, 2, 1))
        return full.transpose(0, 2, 1, 3).reshape(K * b, K * b)

    def diagonal(self) -> Float[Array, "size t"]:
        own = jnp.diagonal(self.blocks, axis1=1, axis2=2)
        diagonal_only = self.pattern.rows == self.pattern.cols
        index = jnp.where(diagonal_only, self.pattern.rows, self.pattern.centres)
        shape = (self.pattern.centres, own.shape[1])
        diagonal = jnp.zeros(shape, own.dtype).at[index].set(own, mode="drop")
        return diagonal.reshape(self.pattern.size, self.t)

    def coordinates(self) -> tuple[Int[Array, "nnz b b"], Int[Array, "nnz b b"]]:
        """Row and column of every stored number in the matrix of `as_matrix`."""
        b = self.blocks.shape[-1]
        inside = jnp.arange(b, dtype=self.pattern.rows.dtype)
        i = self.pattern.rows[:, None, None] * b + inside[:, None]
        j = self.pattern.cols[:, None, None] * b + inside[None, :]
        shape = self.blocks.shape
        return jnp.broadcast_to(i, shape), jnp.broadcast_to(j, shape)

    def transpose(self):
        return self

    def in_structure(self):
        # as inside a traced function: in a shard_map types carry the mesh
        shape = (self.pattern.size, self.t)
        return jax.eval_shape(lambda: jnp.zeros(shape, self.blocks.dtype))

    def out_structure(self):
        return self.in_structure()


def declare_symmetric(operator: type[lx.AbstractLinearOperator]) -> None:
    """Answer what lineax asks by singledispatch when a solve is built, differentiated or
    transposed."""
    lx.is_symmetric.register(operator)(lambda _: True)
    for query in (
        lx.is_diagonal, lx.is_tridiagonal, lx.is_lower_triangular,
        lx.is_upper_triangular, lx.has_unit_diagonal, lx.is_positive_semidefinite,
        lx.is_negative_semidefinite,
    ):  # fmt: skip
        query.register(operator)(lambda _: False)
    for same in (lx.linearise, lx.materialise, lx.conj):
        same.register(operator)(lambda operator: operator)


declare_symmetric(SparseSymmetric)


def sparsity(
    families_of_centres: Sequence[Int[np.ndarray, "_ _"]],
    points: Float[np.ndarray, "K s"],
    radii: Float[np.ndarray, " K"],
    functions: int,
    on_curve: bool,
) -> tuple[SparsityPattern, tuple[Int[Array, "_ _"], ...]]:
    """Pattern of a sum of element matrices: all pairs of centres whose supports meet, so
    it is the same for all data. Host.

    **Arguments:** `families_of_centres`: for each family of elements their centres,
    ascending (negative: padding, last); `points`, `radii` the centres' supports;
    `on_curve`: whether to find the width of the band.
    **Returns** the pattern, and for each family the places in it of the element's pairs
    of centres i <= j, past its end where there is nothing to add.
    """
    K = len(points)
    reach = radii * (1 - 1e-12)

    def keys(i, j, pair):
        apart = np.sqrt(sum((x[i] - x[j]) ** 2 for x in points.T))
        return np.where(pair & (apart < reach[i] + reach[j]), i * K + j, K**2)

    near = KDTree(points).query_ball_point(points, radii + np.max(radii))
    i = np.repeat(np.arange(K), [len(own) for own in near])
    j = np.concatenate([np.asarray(own, dtype=np.int64) for own in near])
    entries = np.unique(keys(i, j, i <= j))
    entries = entries[entries < K**2]
    rows, cols = (a.astype(np.int32) for a in np.divmod(entries, K))
    places = []
    for own in families_of_centres:
        own = np.asarray(own, dtype=np.int64)
        first, second = (own[:, side] for side in np.triu_indices(own.shape[1]))
        into = np.searchsorted(entries, keys(first, second, second >= 0))
        places.append(into.astype(np.int32))
    band = int(np.max(cols - rows)) + 1 if on_curve else None
    rows, cols = jax.device_put((rows, cols))
    pattern = SparsityPattern(rows, cols, K, functions, band)
    return pattern, jax.device_put(tuple(places))


def band_order(
    points: Float[np.ndarray, "K s"], radii: Float[np.ndarray, " K"]
) -> Int[np.ndarray, " K"]:
    """Centres of a curve so that those which interact are near each other: along an open
    one, both ways round a closed one (reverse Cuthill-McKee). Host."""
    tree = KDTree(points)
    near = tree.sparse_distance_matrix(
        tree, 2 * np.max(radii), output_type="coo_matrix"
    )
    meet = near.data <= radii[near.row] + radii[near.col]
    pairs = near.row[meet], near.col[meet]
    near = coo_matrix((near.data[meet], pairs), shape=near.shape)
    return reverse_cuthill_mckee(near.tocsr(), symmetric_mode=True)[::-1]
