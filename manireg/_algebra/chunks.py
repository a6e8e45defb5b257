"""Loops over the leading axis of arrays, a chunk at a time, whose body is compiled once:
where chunks do not come out even, the last one overlaps the one before. Only as many
entries are visited as there are, whatever the arrays are filled up to."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, PyTree


def scan_chunks(
    add: Callable[[Any, PyTree, Bool[Array, " size"]], Any],
    carry: Any,
    arrays: PyTree,
    largest: float,
    count: Int[Array, ""],
) -> Any:
    """`carry = add(carry, chunk, new)` for chunks of at most `largest` entries, of the
    first `count`; `new`: which of them have not been in a chunk before."""
    size, n = _sizes(arrays, largest)

    def next_chunk(i, carry):
        start = jnp.minimum(i * size, n - size)
        new = start + jnp.arange(size) >= i * size
        return add(carry, _chunk(arrays, start, size), new)

    return jax.lax.fori_loop(0, -(-count // size), next_chunk, carry)


def map_chunks(
    f: Callable[[PyTree], PyTree], arrays: PyTree, largest: float, count: Int[Array, ""]
) -> PyTree:
    """`f` of chunks of at most `largest` entries, of the first `count`, put together
    again (zeros for the others)."""
    size, n = _sizes(arrays, largest)
    of_chunk = lambda start: f(_chunk(arrays, start, size))
    shapes = jax.eval_shape(of_chunk, 0)
    zeros = jax.tree.map(lambda a: jnp.zeros((n, *a.shape[1:]), a.dtype), shapes)

    def next_chunk(i, found):
        start = jnp.minimum(i * size, n - size)
        put = lambda a, part: jax.lax.dynamic_update_slice_in_dim(a, part, start, 0)
        return jax.tree.map(put, found, of_chunk(start))

    return jax.lax.fori_loop(0, -(-count // size), next_chunk, zeros)


def _sizes(arrays: PyTree, largest: float) -> tuple[int, int]:
    """Entries in a chunk, and in all."""
    n = len(jax.tree.leaves(arrays)[0])
    count = -(-n // max(int(largest), 1))
    return -(-n // count), n


def _chunk(arrays: PyTree, start, size: int) -> PyTree:
    return jax.tree.map(lambda a: jax.lax.dynamic_slice_in_dim(a, start, size), arrays)
