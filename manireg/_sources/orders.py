"""Orders of energies: which are defined from one space to another, which have minimisers,
and what costs nothing under them."""

import math

import numpy as np

from .._source import AbstractSource
from ..manifolds import AbstractManifold
from .checks import check_source, check_target


def least_inputs(source: AbstractSource, order: int) -> int:
    """Distinct ones; in flat spaces as many as there are polynomials of no energy."""
    m = source.dim
    return null_dimension(source, order) if _flat(source) else m + 2


def null_dimension(source: AbstractSource, order: int) -> int:
    """Of the functions of no energy: polynomials of a degree below `order`, or constants
    on sources that close up."""
    return math.comb(order - 1 + source.dim, source.dim) if _flat(source) else 1


def _flat(source: AbstractSource) -> bool:
    return source.linear or source.sampled is not source


def least_order(source: AbstractSource) -> int:
    """Of energies whose minimisers are continuous: 2 p > m."""
    return source.sampled.dim // 2 + 1


def highest_order(source: AbstractSource, target: AbstractManifold) -> int:
    """To which the geodesics of both are known."""
    if source.sampled is source and source.known_points() is not None:
        return 2
    curve = source.sampled is source and source.dim == 1
    return 4 if curve and target.known_points() is None else 3


def check_order(order: int, source: AbstractSource, target: AbstractManifold):
    """Of the energy of a regression."""
    check_known(order, source, target)
    least, name = least_order(source), type(source.sampled).__name__
    if order < least:
        allowed = least <= highest_order(source, target)
        cure = f"Take `order={least}`, or" if allowed else "Take"
        raise ValueError(
            f"order: {name} has dimension {source.sampled.dim}, where energies of "
            f"derivatives of order {order} have no minimisers: narrow spikes go through "
            f"any data at no cost. {cure} fewer inputs, or "
            "manireg.baselines.nadaraya_watson."
        )


def check_known(order: int, source: AbstractSource, target: AbstractManifold):
    """Whether an energy is defined."""
    check_source(source)
    check_target(target)
    if isinstance(order, bool) or order not in (1, 2, 3, 4):
        raise ValueError(f"order: expected 1, 2, 3 or 4, found {order!r}.")
    highest = highest_order(source, target)
    if order > highest:
        names = type(source).__name__, type(target).__name__
        raise ValueError(
            f"order: at most {highest} from {names[0]} to {names[1]}, found {order}. The "
            "fourth is for curves, and for targets that are no scans; of scans as sources "
            "only the curvature is known: take 2, or Ambient(source) for 3."
        )


def check_tension(tension: float, source: AbstractSource, order: int = 2):
    if not (np.isfinite(tension) and tension >= 0):
        raise ValueError(f"tension: must be finite and at least 0, found {tension}.")
    if tension and source.sampled is source:
        raise ValueError(
            f"tension: only for `Ambient` sources, found {type(source).__name__}. Leave "
            "it out, or take Ambient(source)."
        )
    if tension and order != 2:
        raise ValueError(f"tension: only for order 2, found order {order}.")
