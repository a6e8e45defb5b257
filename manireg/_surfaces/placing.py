"""Landmarks put onto their surface: in its coordinate system, at its closest points."""

import warnings

import numpy as np
from jaxtyping import Float

from .._input.shown import shown
from .._sources.checks import OFF_SURFACE, check_landmarks, projected
from ..manifolds._scans.surface import Surface
from .landmarks import Landmarks
from .pairs import listed

FLIP = np.array([-1.0, -1.0, 1.0])  # between LPS and RAS
CLEAR = 0.25  # so much nearer have landmarks to be for another system to be taken
NEAR = 1e-3  # of the size: landmarks farther off the surface are named in a note
UNITS = (1e3, 1e-3, 10.0, 0.1, 100.0, 0.01, 1e6, 1e-6, 25.4, 1 / 25.4)


def placed(
    name: str, landmarks: Landmarks, surface: Surface
) -> Float[np.ndarray, "l 3"]:
    """The points of the surface that landmarks are."""
    if landmarks.vertices is not None:
        positions = surface.vertices[_numbers(name, landmarks, surface)]
    else:
        assert landmarks.positions is not None
        positions = landmarks.positions
    bad = np.flatnonzero(~np.all(np.isfinite(positions), axis=1))
    if len(bad):
        raise ValueError(
            f"{name}: NaN or infinity in {len(bad)} of {len(positions)} (first at index "
            f"{bad[0]}); remove these pairs."
        )
    if landmarks.vertices is not None:
        return check_landmarks(name, surface.cloud, positions, landmarks.names)
    positions, gaps = _in_system(name, landmarks, positions, surface)
    hint = _hint(positions, gaps, surface)
    landed = check_landmarks(name, surface.cloud, positions, landmarks.names, hint)
    off = np.flatnonzero(gaps > NEAR * surface.size)
    if len(off):
        worst = gaps.max()
        warnings.warn(
            f"{name}: {len(off)} of {len(gaps)} lie off the surface, up to "
            f"{worst:.2g} ({100 * worst / surface.size:.2g} % of its size): "
            f"{listed(landmarks.names[i] for i in off)}; its closest points are taken.",
            stacklevel=4,
        )
    return landed


def _numbers(name: str, landmarks: Landmarks, surface: Surface) -> np.ndarray:
    numbers, n = landmarks.vertices, len(surface.vertices)
    assert numbers is not None
    if not surface.numbered:
        raise ValueError(
            f"{name}: vertex numbers, but STL files do not number vertices. Give "
            "positions (l, 3), or a mesh as PLY or OBJ."
        )
    if landmarks.origin and numbers.min() >= 1 and numbers.max() == n:
        warnings.warn(
            f"{name}: {landmarks.origin} counts vertices from 1: it has number {n}, and "
            f"there are {n}. 1 is subtracted from all.",
            stacklevel=5,
        )
        numbers = numbers - 1
    wrong = numbers[(numbers < 0) | (numbers >= n)]
    if len(wrong):
        raise ValueError(
            f"{name}: vertex {wrong[0]} does not exist; there are {n}, numbered from 0."
        )
    return numbers


def _gaps(positions, surface: Surface) -> Float[np.ndarray, " l"]:
    landed = np.asarray(projected(surface.cloud, positions))
    return np.linalg.norm(landed - positions, axis=1)


def _in_system(name: str, landmarks: Landmarks, positions, surface: Surface):
    """Positions in the coordinate system of the surface, which its file does not tell,
    and their distances to it."""
    gaps = _gaps(positions, surface)
    if landmarks.system is None or np.median(gaps) <= NEAR * surface.size:
        return positions, gaps
    flipped = positions * FLIP
    other = _gaps(flipped, surface)
    if np.median(other) > CLEAR * np.median(gaps):
        return positions, gaps
    mine, yours = {"LPS": ("LPS", "RAS"), "RAS": ("RAS", "LPS")}[landmarks.system]
    warnings.warn(
        f"{name}: {landmarks.origin or 'they'} has {mine} coordinates, the surface {yours}"
        " by where they lie; x and y are negated.",
        stacklevel=5,
    )
    return flipped, other


def _hint(positions, gaps, surface: Surface) -> str:
    """What would bring landmarks that are off the surface onto it."""
    limit = OFF_SURFACE * surface.size
    if gaps.max() <= limit:
        return ""
    if np.all(_gaps(positions * FLIP, surface) <= limit):
        return (
            "They lie on it with x and y negated (LPS and RAS of medical images): "
            "multiply positions by [-1, -1, 1]."
        )
    for factor in UNITS:
        if np.all(_gaps(positions * factor, surface) <= limit):
            by = shown(factor)
            return f"They lie on it in another unit: multiply positions by {by}."
    if np.mean(gaps <= limit) > 0.5:
        return "Most others lie on it: is this one mistaken?"
    return "Wrong units or the wrong mesh?"
