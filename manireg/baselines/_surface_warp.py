"""What the warps of space return, and how well they predict landmarks they were not
given."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from .._input.numbers import Numbers, as_numbers
from .._input.precision import check_x64
from .._selection.folds import training_sets
from .._sources import checks
from ..manifolds import PointCloud


class SurfaceWarp(eqx.Module):
    """Where a warp of space sends a surface. `warp(x)` is on the target, for any points
    of space."""

    target: PointCloud
    deformation: Callable[[np.ndarray], np.ndarray] = eqx.field(static=True)
    deformed: Float[np.ndarray, "n 3"]
    """The source's vertices as the warp leaves them, near the target at best."""
    vertices: Float[np.ndarray, "n 3"]
    """`deformed`, moved to the closest points of the target."""

    def ambient(self, x: Numbers) -> Float[np.ndarray, "n 3"]:
        """The warp itself, before the projection."""
        return self.deformation(checked_positions("x", x))

    def __call__(self, x: Numbers) -> Float[np.ndarray, "n 3"]:
        return projected(self.target, self.ambient(x))


def surface_warp(target: PointCloud, deformation, vertices) -> SurfaceWarp:
    deformed = deformation(vertices)
    return SurfaceWarp(target, deformation, deformed, projected(target, deformed))


def held_out_errors(
    fit: Callable[[np.ndarray, np.ndarray], Callable[[np.ndarray], np.ndarray]],
    source_landmarks: Numbers,
    target_landmarks: Numbers,
    *,
    folds: int | None = None,
    key: PRNGKeyArray | None = None,
) -> Float[np.ndarray, " l"]:
    """How far each landmark is sent from where it belongs by a map that was fitted
    without it: what the parameters of a warp can be chosen by.

    **Arguments:** `fit(source_landmarks, target_landmarks)` returns a map of points,
    such as a `SurfaceWarp` (or its `ambient`); `folds` as for
    `manireg.cross_validate`, default: one landmark at a time.
    """
    x, y = checked_pairs(source_landmarks, target_landmarks)
    errors = np.zeros(len(x))
    for training in training_sets(
        np.ones(len(x)), len(x) if folds is None else folds, key
    ):
        held = ~np.asarray(training)
        predicted = fit(x[~held], y[~held])(x[held])
        errors[held] = np.linalg.norm(predicted - y[held], axis=1)
    return errors


def projected(target: PointCloud, points: np.ndarray) -> np.ndarray:
    check_x64(target)
    return np.asarray(checks.projected(target, jnp.asarray(points)))


# Checks


def checked_positions(name: str, points, like=None) -> np.ndarray:
    """Points of space, as many as there are in `like`."""
    points = as_numbers(name, points)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(
            f"{name}: expected positions (n, 3), found shape {points.shape}. (Of vertex "
            "numbers: vertices[numbers].)"
        )
    bad = np.flatnonzero(~np.all(np.isfinite(points), axis=1))
    if len(bad):
        raise ValueError(
            f"{name}: {len(bad)} of {len(points)} points hold NaN or infinity or are "
            f"missing (first at index {bad[0]}); remove them."
        )
    if like is not None and len(points) != len(like):
        raise ValueError(f"{name}: expected {len(like)} points, found {len(points)}.")
    return points


def checked_pairs(source_landmarks, target_landmarks) -> tuple[np.ndarray, np.ndarray]:
    x = checked_positions("source_landmarks", source_landmarks)
    y = checked_positions("target_landmarks", target_landmarks, like=x)
    if len(x) < 5:
        raise ValueError(f"landmarks: at least 5 pairs are needed, found {len(x)}.")
    if len(np.unique(x, axis=0)) < len(x):
        raise ValueError("source_landmarks: some occur twice; drop the copies.")
    # affine maps of space are free, so landmarks have to fix them
    extents = np.linalg.svd(x - x.mean(0), compute_uv=False)
    if extents[2] < 1e-4 * extents[0]:
        raise ValueError(
            "source_landmarks: all in one plane; spread them out in all directions."
        )
    return x, y


def checked_task(source_vertices, source_landmarks, target_landmarks, target):
    """Vertices and pairs of landmarks, those of the target on the target."""
    if not isinstance(target, PointCloud) or target.dim != 2:
        raise ValueError(
            f"target: expected a PointCloud in space, found {type(target).__name__}; "
            "manireg.PointCloud.from_mesh makes one of a mesh."
        )
    vertices = checked_positions("source_vertices", source_vertices)
    x, y = checked_pairs(source_landmarks, target_landmarks)
    checks.check_landmarks("target_landmarks", target, y)
    return vertices, x, y
