"""Two surfaces and their landmarks as they are given: loaded, matched, placed, doubted."""

import re
import warnings
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..manifolds._scans.surface import Surface, SurfaceLike, load_surface
from .landmarks import LandmarksLike, as_landmarks
from .orientation import check_orientation, normals_at
from .pairs import Matched, matched
from .placing import placed
from .suspects import warn_of_suspects

FEWEST = 5  # pairs of landmarks


class CheckedPair(NamedTuple):
    """Of the landmarks those that are on both."""

    source: Surface
    target: Surface
    pairs: Matched
    x: Float[np.ndarray, "l 3"]
    """On the source."""
    y: Float[np.ndarray, "l 3"]


def checked_pair(
    source: SurfaceLike,
    target: SurfaceLike,
    source_landmarks: LandmarksLike,
    target_landmarks: LandmarksLike,
) -> CheckedPair:
    """**Raises** ValueError and **warns** as `register` says."""
    ours, theirs = loaded("source", source), loaded("target", target)
    pairs = matched(
        as_landmarks("source_landmarks", source_landmarks),
        as_landmarks("target_landmarks", target_landmarks),
    )
    if len(pairs.names) < FEWEST:
        raise ValueError(
            f"landmarks: at least {FEWEST} pairs are needed, found {len(pairs.names)} on "
            f"the source and {len(pairs.names)} on the target."
        )
    x = placed("source_landmarks", pairs.source, ours)
    y = placed("target_landmarks", pairs.target, theirs)
    for name, places in (("source_landmarks", x), ("target_landmarks", y)):
        spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if spread[1] <= 1e-3 * spread[0]:
            raise ValueError(f"{name}: all on one line; spread them out.")
    if ours.faces is not None:
        at_source = normals_at(ours.cloud, x)
        check_orientation(x, y, at_source, normals_at(theirs.cloud, y))
    warn_of_suspects(x, y, pairs.names)
    return CheckedPair(ours, theirs, pairs, x, y)


def loaded(name: str, surface: SurfaceLike) -> Surface:
    try:
        found = load_surface(surface)
    except ValueError as error:
        raise ValueError(
            re.sub("^(mesh|surface|points):", f"{name}:", str(error))
        ) from error
    if found is not surface and found.report.notable:
        warnings.warn(f"{name}: {found.report.notable}.", stacklevel=5)
    return found
