"""Triangles that a registration turns over, and maps without them."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from ..manifolds import PointCloud

COLLAPSED = 1e-9  # of the mean area: a triangle without a side
RAISES = 10  # times the stiffness grows
FACTOR = 4.0


def agreement(
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    target: PointCloud,
) -> Float[np.ndarray, " f"]:
    """Cosine between the normal of each triangle and that of the target at its centroid:
    negative where it is folded over, NaN where it has collapsed."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    normals = np.cross(b - a, c - a)
    doubled = np.linalg.norm(normals, axis=1)
    flat = doubled <= COLLAPSED * np.mean(doubled)
    normals /= np.where(flat, np.nan, doubled)[:, None]
    # on the host: in a program a single centroid far away holds up all the others
    nearest = KDTree(np.asarray(target.points)).query(vertices[faces].mean(axis=1))[1]
    return np.sum(normals * np.asarray(target.normals)[nearest], axis=1)


Fit = TypeVar("Fit")


def without_folds(
    fit: Fit, folds: Callable[[Fit], int], stiffer: Callable[[float, Fit], Fit]
) -> tuple[Fit, int]:
    """Of `stiffer(factor, near)`, near a fit, the one of the least factor of those tried
    that folds nothing, and how many triangles it does fold: 0, or that of the best where
    none is without."""
    best, fewest = fit, folds(fit)
    lower, near = 1.0, fit
    for _ in range(RAISES):
        if fewest == 0:
            break
        trial = stiffer(lower * FACTOR, near)
        found = folds(trial)
        if found < fewest:
            best, fewest = trial, found
        if found > 0:
            lower, near = lower * FACTOR, trial
    if fewest == 0 and best is not fit:
        between = stiffer(lower * FACTOR**0.5, near)
        best = between if folds(between) == 0 else best
    return best, fewest
