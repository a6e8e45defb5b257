"""Errors of the inputs: what is said of them, checked."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._input.numbers import Numbers, as_numbers
from .._input.shown import shown
from .._source import AbstractSource


class InputErrors(NamedTuple):
    """Of each datum what its true input may be: normal around the one given, or uniform
    between two ends."""

    deviation: Float[np.ndarray, " k"]
    """Standard deviation, of either."""
    lower: Float[np.ndarray, " k"] | None
    """The ends, where uniform."""
    upper: Float[np.ndarray, " k"] | None


def check_input_errors(
    source: AbstractSource,
    x: Float[np.ndarray, "k s"],
    x_sigma: Numbers | None,
    x_min: Numbers | None,
    x_max: Numbers | None,
) -> InputErrors | None:
    """None if nothing is given. **Raises** ValueError that says what is wrong."""
    given = [v is not None for v in (x_sigma, x_min, x_max)]
    if not any(given):
        return None
    if given not in ([True, False, False], [False, True, True]):
        raise ValueError(
            "x_sigma, x_min, x_max: give standard deviations, or both ends of ranges; a "
            "single x_min or x_max, or both kinds, say no distribution."
        )
    if not (source.linear and source.dim == 1):
        raise ValueError(
            "x_sigma, x_min, x_max: only for inputs that are numbers on an `Interval`; "
            f"found {type(source).__name__}."
        )
    k = len(x)
    if x_sigma is not None:
        deviation = _numbers("x_sigma", x_sigma, k)
        _refuse("x_sigma", deviation, deviation < 0, "must not be negative")
        return InputErrors(deviation, None, None)
    lower, upper = _numbers("x_min", x_min, k), _numbers("x_max", x_max, k)
    _refuse("x_min", lower, lower > upper, "must not be above x_max")
    inside = (lower <= x[:, 0]) & (x[:, 0] <= upper)
    _refuse("x", x[:, 0], ~inside, "must lie between x_min and x_max")
    return InputErrors((upper - lower) / np.sqrt(12), lower, upper)


def _numbers(name: str, values: Numbers | None, k: int) -> Float[np.ndarray, " k"]:
    numbers = as_numbers(name, values)
    if numbers.shape not in ((), (k,)):
        raise ValueError(
            f"{name}: expected one number or shape ({k},), one for each datum, found "
            f"{numbers.shape}."
        )
    numbers = np.broadcast_to(numbers, (k,)).astype(float)
    _refuse(name, numbers, ~np.isfinite(numbers), "must be finite")
    return numbers


def _refuse(name: str, values, bad, demand: str) -> None:
    where = np.flatnonzero(bad)
    if len(where):
        raise ValueError(
            f"{name}: {demand}; {len(where)} of {len(values)} are not so, first "
            f"{shown(values[where[0]])} at index {where[0]}."
        )
