"""From what users give as landmarks to pairs of points of two surfaces."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..manifolds._scans.surface import Surface
from .landmarks import LandmarksLike, as_landmarks
from .orientation import check_orientation, normals_at
from .pairs import matched
from .placing import placed
from .suspects import warn_of_suspects

LEAST = 5
FLAT = 1e-3  # of the longest spread: landmarks on one line


class LandmarkPairs(NamedTuple):
    """Points of the source, and where they belong on the target."""

    names: tuple[str, ...]
    x: Float[np.ndarray, "l 3"]
    y: Float[np.ndarray, "l 3"]
    numbers: list[int]
    """Of each pair, its number among the landmarks of the source."""


def landmark_pairs(
    source: Surface,
    target: Surface,
    source_landmarks: LandmarksLike,
    target_landmarks: LandmarksLike,
) -> LandmarkPairs:
    """Matched, on their surfaces, and checked: enough, not on one line, of one hand."""
    pairs = matched(
        as_landmarks("source_landmarks", source_landmarks),
        as_landmarks("target_landmarks", target_landmarks),
    )
    if len(pairs.names) < LEAST:
        raise ValueError(
            f"landmarks: at least {LEAST} pairs are needed, found {len(pairs.names)} on "
            f"the source and {len(pairs.names)} on the target."
        )
    x = placed("source_landmarks", pairs.source, source)
    y = placed("target_landmarks", pairs.target, target)
    for name, places in (("source_landmarks", x), ("target_landmarks", y)):
        spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if spread[1] <= FLAT * spread[0]:
            raise ValueError(f"{name}: all on one line; spread them out.")
    if source.faces is not None:
        sides = normals_at(source.cloud, x), normals_at(target.cloud, y)
        check_orientation(x, y, *sides)
    warn_of_suspects(x, y, pairs.names)
    return LandmarkPairs(pairs.names, x, y, pairs.numbers)


def nothing_paired() -> LandmarkPairs:
    """Of surfaces without landmarks."""
    return LandmarkPairs((), np.zeros((0, 3)), np.zeros((0, 3)), [])
