"""Errors of the inputs: what is said of them, checked."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._input.numbers import Numbers, as_numbers
from .._input.shown import shown
from .._source import AbstractSource

NO_DISTRIBUTION = (
    "x_sigma, x_min, x_max: give standard deviations, or both ends of ranges, or of each "
    "datum one of them and NaN for the other; a single x_min or x_max, or both kinds, say "
    "no distribution."
)


class InputErrors(NamedTuple):
    """Of each datum what its true input may be: normal around the one given, or uniform
    between two ends."""

    deviation: Float[np.ndarray, " k"]
    """Standard deviation, of either."""
    lower: Float[np.ndarray, " k"] | None
    """The ends, where uniform; NaN of data that are normal beside such."""
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
    if given[1] != given[2]:
        raise ValueError(NO_DISTRIBUTION)
    if not (source.linear and source.dim == 1):
        raise ValueError(
            "x_sigma, x_min, x_max: only for inputs that are numbers on an `Interval`; "
            f"found {type(source).__name__}."
        )
    k, both = len(x), all(given)
    deviation = lower = upper = None
    if x_sigma is not None:
        deviation = _numbers("x_sigma", x_sigma, k, both)
        _refuse("x_sigma", deviation, deviation < 0, "must not be negative")
    if x_min is not None:
        lower = _numbers("x_min", x_min, k, both)
        upper = _numbers("x_max", x_max, k, both)
        _refuse("x_min", lower, lower > upper, "must not be above x_max")
        outside = (x[:, 0] < lower) | (upper < x[:, 0])
        _refuse("x", x[:, 0], outside, "must lie between x_min and x_max")
    if lower is None or upper is None:
        assert deviation is not None
        return InputErrors(deviation, None, None)
    uniform = (upper - lower) / np.sqrt(12)
    if deviation is None:
        return InputErrors(uniform, lower, upper)
    missing = [np.isnan(end) for end in (lower, upper)]
    unclear = (missing[0] != missing[1]) | (missing[0] == np.isnan(deviation))
    if unclear.any():
        i = int(np.argmax(unclear))
        raise ValueError(f"{NO_DISTRIBUTION} First at index {i}.")
    return InputErrors(np.where(missing[0], deviation, uniform), lower, upper)


def _numbers(
    name: str, values: Numbers | None, k: int, gaps: bool
) -> Float[np.ndarray, " k"]:
    numbers = as_numbers(name, values)
    if numbers.shape not in ((), (k,)):
        raise ValueError(
            f"{name}: expected one number or shape ({k},), one for each datum, found "
            f"{numbers.shape}."
        )
    numbers = np.broadcast_to(numbers, (k,)).astype(float)
    bad = np.isinf(numbers) if gaps else ~np.isfinite(numbers)
    _refuse(name, numbers, bad, "must be finite")
    return numbers


def _refuse(name: str, values, bad, demand: str) -> None:
    where = np.flatnonzero(bad)
    if len(where):
        raise ValueError(
            f"{name}: {demand}; {len(where)} of {len(values)} are not so, first "
            f"{shown(values[where[0]])} at index {where[0]}."
        )
