"""A number as messages and tables show it."""

from typing import Any

import numpy as np
from jaxtyping import ScalarLike


def shown(value: ScalarLike) -> str:
    """The shortest digits that read back as the same number, without a trailing `.0`:
    two numbers that differ look different (1.7e9 + 0.05 is 1700000000.05)."""
    number: Any = np.asarray(value)[()]
    if number.dtype.kind != "f":
        return str(number)
    plain = 1e-4 <= abs(number) < 1e16 or number == 0
    show = np.format_float_positional if plain else np.format_float_scientific
    return show(number, trim="-")


def listed(values) -> str:
    """A number, or the list of them, as `shown`."""
    array = np.asarray(values)
    return f"[{', '.join(map(listed, array))}]" if array.ndim else shown(array[()])
