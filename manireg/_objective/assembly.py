"""From second derivatives at points to a sparse matrix, sum_q A_q^T local_q A_q, element
by element."""

import functools
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._algebra.chunks import scan_chunks
from .._algebra.sparse import SparseSymmetric, SparsityPattern
from .._discretisation.jets import Jets

CHUNK_BYTES = 1_000_000  # assembled at a time: few stay in the cache


class PointHessians(eqx.Module):
    """Weighted second derivatives of the densities of a site in the jets."""

    at_points: Float[Array, "e p Jt Jt"]
    jets: Jets
    places: tuple[Int[Array, "_ _"], ...]
    """For each bucket of elements, where its pairs of centres are in the pattern."""
    rows: tuple[int, ...] = eqx.field(static=True)
    """Of a jet, those in `at_points`."""


def assembled(
    pattern: SparsityPattern, families: Sequence[PointHessians]
) -> SparseSymmetric:
    """sum_q A_q^T local_q A_q."""
    first = families[0]
    b = pattern.functions * first.at_points.shape[-1] // len(first.rows)
    blocks = jnp.zeros((len(pattern.rows), b, b))
    for family in families:
        jets, rows = family.jets, np.array(family.rows)
        for (start, stop, U), into in zip(jets.buckets, family.places, strict=True):
            matrices = jets.matrices[start:stop, :, rows, :U]
            count = jnp.minimum(jets.count - start, stop - start)
            blocks = _add(blocks, family.at_points[start:stop], matrices, into, count)
    return SparseSymmetric(blocks, pattern)


def _add(
    blocks: Float[Array, "nnz b b"],
    local: Float[Array, "e p Jt Jt"],
    matrices: Float[Array, "e p J U"],
    into: Int[Array, "e pairs"],
    count: Int[Array, ""],
):
    """Add A^T local A of all points, a chunk of elements at a time."""
    e, p, J, U = matrices.shape
    t = local.shape[-1] // J
    halves, wholes = t * (t + 1) / 2 * p * J * U, into.shape[1] * blocks[0].size
    largest = CHUNK_BYTES / (local.dtype.itemsize * max(halves, wholes))

    def add(blocks, chunk, new):
        local, matrices, into = chunk
        return _add_chunk(blocks, local * new[:, None, None, None], matrices, into)

    return scan_chunks(add, blocks, (local, matrices, into), largest, count)


def _add_chunk(blocks, local, matrices, into):
    """One dense product an element and pair of coordinates a <= b, then a scatter. The
    product for (b, a) is the transpose of that for (a, b)."""
    e, p, J, U = matrices.shape
    t = local.shape[-1] // J
    a, b = np.triu_indices(t)
    local = local.reshape(e, p, J, t, J, t).transpose(0, 3, 5, 1, 2, 4)[:, a, b]
    terms = [local[..., k, None] * matrices[:, None, :, None, k] for k in range(J)]
    half = functools.reduce(jnp.add, terms).reshape(e, len(a), p * J, U)
    whole = jnp.einsum("equ,enqv->enuv", matrices.reshape(e, p * J, U), half)

    pair = np.zeros((t, t), dtype=int)
    pair[a, b] = pair[b, a] = np.arange(len(a))
    upper = np.triu(np.ones((t, t), dtype=bool))[:, :, None, None]
    whole = jnp.where(upper, whole[:, pair], whole.swapaxes(2, 3)[:, pair])
    size = blocks.shape[-1]
    L = U * t // size
    i, j = np.triu_indices(L)
    whole = whole.reshape(e, t, t, L, size // t, L, size // t)
    by_centre = whole.transpose(0, 3, 5, 4, 1, 6, 2)[:, i, j]
    return blocks.at[into].add(by_centre.reshape(e, len(i), size, size), mode="drop")
