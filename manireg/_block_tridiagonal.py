"""Symmetric block tridiagonal systems."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def solve_tridiagonal(
    diagonal: Float[Array, "n m m"],
    side: Float[Array, "n-1 m m"],
    rhs: Float[Array, "n m"],
):
    """Solution with the symmetric matrix of blocks `diagonal` and, right of them, `side`;
    and whether the matrix is positive definite. By block elimination."""
    nothing = jnp.zeros((1, *side.shape[1:]))
    left = jnp.concatenate([nothing, jnp.swapaxes(side, 1, 2)])
    right = jnp.concatenate([side, nothing])

    def eliminate(before, blocks):
        diagonal, left, right, rhs = blocks
        both = jnp.concatenate([diagonal, rhs[:, None]], axis=1) - left @ before
        factor = jnp.linalg.cholesky(both[:, :-1])
        sides = jnp.concatenate([right, both[:, -1:]], axis=1)
        reduced = jax.scipy.linalg.cho_solve((factor, True), sides)
        return reduced, (reduced, jnp.all(jnp.isfinite(factor)))

    def substitute(after, reduced):
        x = reduced[:, -1] - reduced[:, :-1] @ after
        return x, x

    start = jnp.zeros((side.shape[1], side.shape[1] + 1))
    _, (reduced, positive) = jax.lax.scan(
        eliminate, start, (diagonal, left, right, rhs)
    )
    _, x = jax.lax.scan(substitute, jnp.zeros(side.shape[1]), reduced, reverse=True)
    return x, jnp.all(positive)
