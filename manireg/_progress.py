"""A progress bar that a compiled program can move."""

import contextlib
import itertools

import jax
import jax.numpy as jnp
from tqdm.auto import tqdm

# A compiled program outlives the bar it was traced with, so it is handed a number and
# looks the bar up here. Entries live only inside `progress_bar`.
_open_bars: dict[int, tqdm] = {}
_numbers = itertools.count()


@contextlib.contextmanager
def progress_bar(total: int, title: str, show: bool):
    """Context with the number of a new bar, for `tick`."""
    number = next(_numbers)
    with tqdm(total=total, desc=title, disable=not show, leave=False) as bar:
        _open_bars[number] = bar
        try:
            yield jnp.asarray(number)
        finally:
            jax.effects_barrier()
            del _open_bars[number]


def tick(number) -> None:
    """Advance the bar by one, from inside a traced function."""
    jax.debug.callback(_advance, number)


def _advance(number):
    if int(number) in _open_bars:
        _open_bars[int(number)].update()
