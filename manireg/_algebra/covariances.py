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


def from_windows(
    factors: Float[Array, "n size size"],
    band: int,
    elements: Elements,
    joint: bool = False,
) -> Float[Array, "..."]:
    """By the factors of `window_factors` for the centres from the first of an element
    on."""
    p, _, f = elements.values.shape[1:]
    size = factors.shape[1]

    def halves(values: Float[Array, "p L f"], centres: Int[Array, " L"]):
        """L^{-1} a in the window that begins at the first centre that counts."""
        counts = (centres >= 0) & jnp.any(values != 0, axis=(0, 2))
        first = jnp.min(jnp.where(counts, centres, len(factors) - 1))
        place = jnp.where(counts, centres - first, band)
        window = jnp.zeros((len(values), band, f)).at[:, place].add(values, mode="drop")
        factor = factors[first].reshape(size, band, f, -1)
        return jnp.einsum("rcfa,pcf->par", factor, window)

    def of_element(element):
        values, columns = element
        centres = columns[::f] // f  # -1 // f is -1
        if joint:  # at one place: all have the same centres
            whole = halves(values, centres)
            return jnp.einsum("par,qbr->paqb", whole, whole)
        # those of a whole element may lie farther apart than centres that meet
        whole = jax.vmap(halves, (0, None))(values[:, None], centres)[:, 0]
        return jnp.einsum("par,pbr->pab", whole, whole)

    every = jax.vmap(of_element)
    return map_chunks(
        every, elements[:2], CHUNK_BYTES / (8 * p * size**2), elements.present
    )


def from_halves(
    half: Callable[[Array], Array],
    shape: tuple[int, ...],
    elements: Elements,
    joint: bool = False,
) -> Float[Array, "..."]:
    """By half(b) = L^{-1} b with L L^T the matrix, of right-hand sides `(*shape, n)`, some
    elements' at a time; `shape` is `(size, t)`."""
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
        found = half(right.reshape(size, t, -1)).reshape(-1, chunk, p, t)
        if joint:
            return jnp.einsum("nepa,neqb->epaqb", found, found)
        return jnp.einsum("nepa,nepb->epab", found, found)

    arrays, largest = elements[:2], CHUNK_BYTES / (8 * size * t * p * t)
    return map_chunks(of_chunk, arrays, largest, elements.present)
