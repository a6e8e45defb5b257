"""From second derivatives at points to a sparse matrix, sum_q A_q^T local_q A_q, element
by element."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._algebra.sparse import SparseSymmetric
from .problem import Problem

VALUE = np.array([0])  # the row of a jet that the loss sees
CHUNK_BYTES = 8_000_000  # assembled at a time: few stay in the cache


class PointHessians(eqx.Module):
    """Weighted second derivatives of the densities in the jets, at every point."""

    energy: Float[Array, "e p Jt Jt"]
    data: Float[Array, "d r t t"]


def assembled(
    problem: Problem, local: PointHessians, energy_rows: np.ndarray
) -> SparseSymmetric:
    """sum_q A_q^T local_q A_q."""
    pattern, t = problem.pattern, problem.y.shape[1]
    b = pattern.functions * t
    blocks = jnp.zeros((len(pattern.rows), b, b))
    for local_hessians, jets, rows, places in (
        (local.energy, problem.energy_jets, energy_rows, problem.energy_places),
        (local.data, problem.data_jets, VALUE, problem.data_places),
    ):
        for (start, stop, U), into in zip(jets.buckets, places, strict=True):
            matrices = jets.matrices[start:stop, :, rows, :U]
            blocks = _add(blocks, local_hessians[start:stop], matrices, into)
    return SparseSymmetric(blocks, pattern)


def _add(
    blocks: Float[Array, "nnz b b"],
    local: Float[Array, "e p Jt Jt"],
    matrices: Float[Array, "e p J U"],
    into: Int[Array, "e pairs"],
):
    """Add A^T local A of all points, a chunk of elements at a time."""
    arrays = (local, matrices, into)
    e, p, J, U = matrices.shape
    t = local.shape[-1] // J
    largest = CHUNK_BYTES / (local.dtype.itemsize * t * (t + 1) / 2 * p * J * U)
    # a power of two, like the number of elements: mostly without a rest
    size = min(2 ** int(np.log2(max(largest, 1))), e)
    chunks = e // size
    first = [a[: chunks * size].reshape(chunks, size, *a.shape[1:]) for a in arrays]
    last = [a[chunks * size :] for a in arrays]
    add = lambda blocks, arrays: (_add_chunk(blocks, *arrays), None)
    blocks, _ = jax.lax.scan(add, blocks, first)
    return _add_chunk(blocks, *last) if e % size else blocks


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
