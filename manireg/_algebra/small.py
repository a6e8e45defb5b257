"""Decompositions of many small matrices, one after the other on the CPU.

jaxlib 0.10 gives a batch to the threads of XLA's pool and waits for them on one of these.
As many batches at a time as there are threads (two on many machines), and all wait for
each other: the program hangs. Mended in jaxlib 0.11.2; of small matrices a loop costs a
third more. Not to be differentiated: whoever calls these knows a better derivative.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp


def _in_turn(decompose: Callable) -> Callable:
    """`decompose` of matrices `(..., n, p)`, never called on a batch on the CPU."""
    loop = lambda a: jax.lax.map(decompose, a)

    @jax.custom_batching.custom_vmap
    def in_turn(a):
        flat = a.reshape(-1, *a.shape[-2:])
        parts = jax.lax.platform_dependent(flat, cpu=loop, default=decompose)
        return tuple(part.reshape(*a.shape[:-2], *part.shape[1:]) for part in parts)

    @in_turn.def_vmap
    def _(axis_size, in_batched, a):
        parts = in_turn(a)
        return parts, tuple(in_batched[0] for _ in parts)

    return in_turn


eigh = _in_turn(lambda s: tuple(jnp.linalg.eigh(s)))
"""Ascending eigenvalues and eigenvectors of Hermitian matrices `(..., n, n)`."""

svd = _in_turn(lambda a: tuple(jnp.linalg.svd(a, full_matrices=False)))
"""Thin singular value decompositions u, s, v^T of matrices `(..., n, p)`."""

_cholesky = _in_turn(lambda a: (jax.lax.linalg.cholesky(a, symmetrize_input=False),))


def inverse_cholesky(a):
    """L^{-1} of A = L L^T, `(n, n)`; not a number where A is not positive definite.

    All by one Cholesky decomposition, of [[A, I], [I, far]]: OpenBLAS shares a triangular
    solve of eight rows among its threads, and those of two programs wait for each other.
    """
    n = len(a)
    far = 1e200  # what comes off it is lost in rounding
    pair = jnp.block([[a, jnp.zeros((n, n))], [jnp.eye(n), far * jnp.eye(n)]])
    return _cholesky(pair)[0][n:, :n].T


def solve_symmetric(a, b):
    """x of A x = b for symmetric matrices A `(..., t, t)`, `b (..., t)`; by elimination
    without pivots, for those that are positive definite or about to be."""
    t = a.shape[-1]
    rows = jnp.concatenate([a, b[..., None]], axis=-1)
    for i in range(t):
        pivot = rows[..., i, :] / rows[..., i, i, None]
        rows = rows - rows[..., :, i, None] * pivot[..., None, :]
        rows = rows.at[..., i, :].set(pivot)
    return rows[..., t]
