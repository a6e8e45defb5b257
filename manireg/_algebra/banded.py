"""Symmetric block banded systems: those of neighbours on a curve."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .small import inverse_cholesky


def solve_banded(
    columns: Float[Array, "n band m m"], rhs: Float[Array, "n sides m"]
) -> Float[Array, "n sides m"]:
    """Solution with the positive definite matrix of blocks `columns[i, d]` in row i + d,
    column i. Not a number where it is not positive definite.

    Cholesky, a block column at a time; right-hand sides are rows below the matrix. Half
    the time of CHOLMOD on curves of 60 centres, a third where two programs run: CHOLMOD's
    take turns.
    """
    _, band, m, _ = columns.shape
    reach, sides = (band - 1) * m, rhs.shape[1]
    below = jnp.concatenate([columns.reshape(-1, reach + m, m), rhs], axis=1)

    def substitute(after, column):
        inverse, factor = column
        x = (factor[reach:] - after @ factor[:reach]) @ inverse
        return jnp.concatenate([x, after], axis=1)[:, :reach], x

    nothing = jnp.zeros((reach + m + sides, reach + m))
    _, factors = jax.lax.scan(_eliminate, nothing, below)
    _, x = jax.lax.scan(substitute, jnp.zeros((sides, reach)), factors, reverse=True)
    return x


def window_factors(
    columns: Float[Array, "n band m m"],
) -> Float[Array, "n size size"]:
    """For the rows and columns that each block column meets, L^{-1} of what is left of
    the matrix once all others are eliminated, from both ends: of vectors a in there
    a^T H^{-1} a = |L^{-1} a|^2, whatever the size of the matrix without the rest of it.
    Not a number where that is not positive definite.

    (The blocks of the inverse themselves, by this or by the recursion of Takahashi, Fagan
    and Chen 1973, are large where functions of neighbours are nearly dependent, and of
    a^T H^{-1} a their rounding is left.)
    """
    n, band, m, _ = columns.shape
    size = band * m
    mirror = n - 1 - np.arange(n)[:, None] - np.arange(band)
    mirrored = jnp.swapaxes(columns[mirror, np.arange(band)], 2, 3)
    mirrored = jnp.where((mirror >= 0)[:, :, None, None], mirrored, 0.0)
    before, after = _eliminated(columns), _eliminated(mirrored)
    last = n - band - np.arange(n)  # of each window, counted from the end
    after = after.reshape(n, band, m, band, m)[last, ::-1, :, ::-1]
    after = jnp.where((last >= 0)[:, None, None, None, None], after, 0.0)

    def factor_of(window, arrays):
        column, gone = arrays
        own, below = column[0], column[1:].reshape(size - m, m)
        window = jnp.block([[own, below.T], [below, window]])
        return window[:-m, :-m], inverse_cholesky(window - gone)

    gone = before + after.reshape(n, size, size)
    beyond = jnp.eye(size - m)
    return jax.lax.scan(factor_of, beyond, (columns, gone), reverse=True)[1]


def _eliminated(columns: Float[Array, "n band m m"]) -> Float[Array, "n size size"]:
    """What the elimination of all block columns before each takes off the rows and
    columns that it meets."""
    n, band, m, _ = columns.shape
    nothing = jnp.zeros((band * m, band * m))
    step = lambda products, below: (_eliminate(products, below)[0], products)
    return jax.lax.scan(step, nothing, columns.reshape(n, band * m, m))[1]


def _eliminate(products: Float[Array, "rows size"], below: Float[Array, "rows m"]):
    """Of the next block column of the Cholesky factor the inverse of the block on the
    diagonal, and what is below it; `products`: of those before, from this row and column
    on."""
    size, m = products.shape[1], below.shape[1]
    reach = size - m
    column = below - products[:, :m]
    inverse = inverse_cholesky(column[:m])
    factor = column[m:] @ inverse.T
    rest = products[m:, m:] + factor @ factor[:reach].T
    rest = jnp.concatenate([rest[:reach], jnp.zeros((m, reach)), rest[reach:]])
    return jnp.pad(rest, ((0, 0), (0, m))), (inverse, factor)
