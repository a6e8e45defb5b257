"""Sizes that arrays are filled up to, so that those of similar size share programs."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import PyTree

from .program import evaluated, program

ROWS = 4096  # at most, of a program that works row by row
FEWEST_ROWS = 16
FEW_DATA = 48, 192, 768


def bucket(n: int) -> int:
    """The next of 1, 2, 3, 4, 6, 8, 12, 16, 24, ...: powers of two and the middles
    between them, a quarter larger than n on average and half at worst."""
    power = 1 << max(n - 1, 0).bit_length()
    return power * 3 // 4 if n <= power * 3 // 4 else power


def data_bucket(k: int) -> int:
    """The same of data, of which few cost less than one more program: 48, 192, 768, then
    as `bucket`."""
    return next((size for size in FEW_DATA if k <= size), bucket(k))


def fewest_data(size: int) -> int:
    """That fill a data bucket of this size."""
    if size > FEW_DATA[-1]:
        return 1 + (size * 3 // 4 if size & (size - 1) == 0 else size * 2 // 3)
    return 1 + max((n for n in FEW_DATA if n < size), default=0)


def filled(array: Any, size: int) -> np.ndarray:
    """`size` rows, the last ones repeating the first."""
    array = np.asarray(array)
    more = np.broadcast_to(array[:1], (size - len(array), *array.shape[1:]))
    return np.concatenate([array, more])


def power_of_four(n: int, least: int) -> int:
    """Times `least`: the first that is not less than n."""
    size = least
    while size < n:
        size *= 4
    return size


def at_each(
    function: Callable, owner: PyTree, *arrays: Any, most: int = ROWS
) -> PyTree:
    """`function(owner, *rows)` for every row of the arrays, stacked, as NumPy arrays. Of
    few sizes of programs: up to `most` rows at a time, a power of four. `function` has to
    be the same object at every call, or it is compiled again."""
    n = len(arrays[0])
    size = power_of_four(min(n, most), least=FEWEST_ROWS)
    parts, host = [], [np.asarray(a) for a in arrays]
    with evaluated():  # all this is known
        for start in range(0, max(n, 1), size):
            rows = [filled(a[start : start + size], size) for a in host]
            parts.append(jax.tree.map(np.asarray, _rows(function, owner, *rows)))
    return jax.tree.map(lambda *a: np.concatenate(a)[:n], *parts)


@program(most=64)
def _rows(function, owner, *arrays):
    return jax.vmap(lambda *rows: function(owner, *rows))(*arrays)
