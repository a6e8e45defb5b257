"""Loops over the leading axis of arrays, a chunk at a time, whose body is compiled once:
where chunks do not come out even, the last one overlaps the one before."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, PyTree


def scan_chunks(
    add: Callable[[Any, PyTree, Bool[Array, " size"]], Any],
    carry: Any,
    arrays: PyTree,
    largest: float,
) -> Any:
    """`carry = add(carry, chunk, new)` for chunks of at most `largest` entries; `new`:
    which of them have not been in a chunk before."""
    starts, size, n = _chunks(arrays, largest)
    first = np.arange(len(starts)) * size

    def next_chunk(carry, at):
        start, first = at
        new = start + jnp.arange(size) >= first
        return add(carry, _chunk(arrays, start, size), new), None

    return jax.lax.scan(next_chunk, carry, (jnp.asarray(starts), jnp.asarray(first)))[0]


def map_chunks(f: Callable[[PyTree], PyTree], arrays: PyTree, largest: float) -> PyTree:
    """`f` of every entry, stacked: under vmap over at most `largest` entries."""
    starts, size, n = _chunks(arrays, largest)
    of_chunk = lambda start: jax.vmap(f)(_chunk(arrays, start, size))
    parts = jax.lax.map(of_chunk, jnp.asarray(starts))
    overlap = len(starts) * size - n

    def joined(a):
        before, last = a[:-1].reshape(-1, *a.shape[2:]), a[-1, overlap:]
        return jnp.concatenate([before, last]) if len(starts) > 1 else a[0]

    return jax.tree.map(joined, parts)


def _chunks(arrays: PyTree, largest: float) -> tuple[np.ndarray, int, int]:
    """Starts of the chunks, entries in each and in all."""
    n = len(jax.tree.leaves(arrays)[0])
    count = -(-n // max(int(largest), 1))
    size = -(-n // count)
    return np.minimum(np.arange(count) * size, n - size), size, n


def _chunk(arrays: PyTree, start, size: int) -> PyTree:
    return jax.tree.map(
        lambda a: jax.lax.dynamic_slice_in_dim(a, start, size), arrays
    )
