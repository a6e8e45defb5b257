"""One method beside another, over the targets that both were run on."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np


class Paired(NamedTuple):
    """As a table has it; empty where the two have no target in common."""

    ratio: str
    """Of the mean errors."""
    wins: int
    """Targets of a smaller error."""
    targets: int


def paired(own: Mapping[object, float], peer: Mapping[object, float]) -> Paired:
    both = [target for target in own if target in peer]
    if not both:
        return Paired("", 0, 0)
    ours, theirs = (np.array([errors[t] for t in both]) for errors in (own, peer))
    ratio = f"{ours.mean() / theirs.mean():.2f}"
    return Paired(ratio, int(np.sum(ours < theirs)), len(both))
