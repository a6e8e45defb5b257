"""Numbers that have to be positive."""

import numpy as np

from .shown import shown


def refuse_other_than_positive(name: str, values: np.ndarray, demand: str, cure: str):
    """Names the first of `values (k,)` that is zero, negative, infinite or missing."""
    bad = np.flatnonzero(~(np.isfinite(values) & (values > 0)))
    if len(bad):
        where = f" at index {bad[0]}" if len(values) > 1 else ""
        raise ValueError(
            f"{name}: {demand}, found {shown(values[bad[0]])}{where}. {cure}"
        )
