"""Triangles that a registration turns over, and maps without them."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from .._selection.one_fit import RTOL
from .._solver.model import RegressionMap
from .._solver.solve import solve
from ..manifolds import PointCloud

COLLAPSED = 1e-9  # of the mean area: a triangle without a side
RAISES = 10  # times lambda grows
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
    centroids = jnp.asarray(vertices[faces].mean(axis=1))
    there = np.asarray(target.normals[target.nearest(centroids)])
    return np.sum(normals * there, axis=1)


def without_folds(
    model: RegressionMap, folds: Callable[[RegressionMap], int]
) -> tuple[RegressionMap, int]:
    """The map of the least lambda of those tried that folds nothing, and how many
    triangles it does fold: 0, or that of the best where none is without."""
    best, fewest = model, folds(model)
    lower, warm = float(model.lam), model.coefficients
    for _ in range(RAISES):
        if fewest == 0:
            break
        lam = lower * FACTOR
        trial = _refitted(model, lam, warm)
        found = folds(trial)
        if found < fewest:
            best, fewest = trial, found
        if found > 0:
            lower, warm = lam, trial.coefficients
    if fewest == 0 and best is not model:
        between = _refitted(model, lower * FACTOR**0.5, warm)
        best = between if folds(between) == 0 else best
    return best, fewest


def _refitted(model: RegressionMap, lam: float, warm) -> RegressionMap:
    assert model.problem is not None
    options = {"starts": (), "warm": warm, "rtol": RTOL, "throw": False}
    return solve(model.problem, lam, **options)
