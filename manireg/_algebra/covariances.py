"""Parts of the inverse of a sparse matrix, as covariances of values that are sums of few
unknowns: at points whose functions are those of a few centres."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .chunks import map_chunks

CHUNK_BYTES = 32_000_000  # of blocks or right-hand sides at a time


class Elements(NamedTuple):
    """Points, p in each element, that share its L centres."""

    values: Float[Array, "e p L f"]
    """Of the f functions of each centre at each point."""
    columns: Int[Array, "e L*f"]
    """Which unknowns these are, negative where there is none."""
    present: Int[Array, ""]
    """How many of the elements hold points; they come first."""
    places: Int[Array, "e pairs"]
    """Where the pairs of centres i <= j are among the blocks of the matrix."""


def from_blocks(
    inverse: Float[Array, "nnz b b"], elements: Elements
) -> Float[Array, "e p t t"]:
    """By the blocks of the inverse for pairs of centres that meet."""
    L, f = elements.values.shape[2:]
    i, j = np.triu_indices(L)
    b = inverse.shape[-1]

    def of_element(element):
        values, places = element
        blocks = inverse.at[places].get(mode="fill", fill_value=0.0)
        blocks = blocks.reshape(len(i), f, b // f, f, b // f)
        half = jnp.einsum("pnf,nfagb->pnagb", values[:, i], blocks)
        each = jnp.einsum("pnagb,png->pnab", half, values[:, j])
        off = jnp.sum(each * (i < j)[:, None, None], axis=1)
        own = jnp.sum(each * (i == j)[:, None, None], axis=1)
        return own + off + jnp.swapaxes(off, 1, 2)

    points = elements.values.shape[1]
    size = 8 * len(i) * b * (b + points * b // f)
    arrays = elements.values, elements.places
    every = jax.vmap(of_element)
    return map_chunks(every, arrays, CHUNK_BYTES / size, elements.present)


def from_solves(
    solve: Callable[[Array], Array], shape: tuple[int, ...], elements: Elements
) -> Float[Array, "e p t t"]:
    """By right-hand sides `(*shape, n)`, some elements' at a time; `shape` is
    `(size, t)`."""
    size, t = shape
    p, L, f = elements.values.shape[1:]

    def of_chunk(arrays):
        values, columns = arrays
        values = values.reshape(-1, p, L * f)
        chunk = len(values)
        element, point = np.arange(chunk)[:, None, None], np.arange(p)[:, None]
        owner = element * p + point
        places = jnp.broadcast_to(columns[:, None], values.shape)
        both = np.arange(t)
        right = jnp.zeros((size, t, chunk * p, t))
        right = right.at[places[..., None], both, owner[..., None], both].add(
            values[..., None]
        )
        found = solve(right.reshape(size, t, -1)).reshape(right.shape)
        found = found[places, :, owner]
        return jnp.einsum("epu,epuab->epab", values, found)

    arrays, largest = elements[:2], CHUNK_BYTES / (8 * size * t * p * t)
    return map_chunks(of_chunk, arrays, largest, elements.present)
