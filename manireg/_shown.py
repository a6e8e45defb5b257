"""Numbers in messages: no digit less than it takes to tell them apart."""

import numpy as np


def shown(value) -> str:
    """The shortest text that identifies a number; of a sequence, the list of them."""
    array = np.asarray(value)
    if array.ndim:
        return f"[{', '.join(map(shown, array))}]"
    return str(array[()]).removesuffix(".0")
