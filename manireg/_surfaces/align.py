"""A similarity that brings one surface near another, from nothing but their shapes."""

import itertools
import warnings
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float

from .._input.numbers import as_numbers
from .._input.precision import check_x64
from ..manifolds import PointCloud
from ..manifolds._scans.surface import SurfaceLike
from .correspondence import OrientedPoints, matches, oriented
from .given import given_surface
from .procrustes import rotations
from .surface_rounds import radius_of_gyration

POINTS, FEW = 2000, 500  # of each surface, drawn by area; and for the first rounds
FIRST, LAST = 8, 40  # rounds: of all beginnings, and of the `KEPT` best of them
KEPT = 4
NORMAL_LENGTH = 1 / 4  # radii of gyration: what a normal off by a radian is worth
ALIKE = 1.1  # times the least distance: another beginning fits as well
APART = np.deg2rad(20)  # between rotations that are not the same


class Similarity(NamedTuple):
    """$x \\mapsto s R x + t$."""

    scale: float
    rotation: Float[np.ndarray, "3 3"]
    shift: Float[np.ndarray, "3"]

    def of(self, surface: OrientedPoints) -> OrientedPoints:
        points = self.scale * surface.points @ self.rotation.T + self.shift
        return surface._replace(
            points=points, normals=surface.normals @ self.rotation.T
        )

    def back(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        return (points - self.shift) @ self.rotation / self.scale

    @property
    def matrix(self) -> Float[np.ndarray, "4 4"]:
        whole = np.eye(4)
        whole[:3, :3], whole[:3, 3] = self.scale * self.rotation, self.shift
        return whole


def align(source: SurfaceLike, target: SurfaceLike) -> Float[np.ndarray, "4 4"]:
    r"""The similarity $x \mapsto s R x + t$ that brings `source` near `target`, as a
    matrix for homogeneous coordinates: where there are no landmarks,

        start = mr.align("mean.ply", "anna.ply")
        found = mr.register("mean.ply", "anna.ply", start=start, surface=True)

    Centroids, sizes and principal axes are brought together in all 24 ways without a
    reflection; from each, points and normals are matched as in `register(surface=True)`
    and the similarity next to the matches is taken, in turns, from the four best until
    the end. Surfaces should show the same part of the object.

    **Warns** (UserWarning) where another rotation fits about as well: of a ball, or of
    what looks the same from two sides, the shape does not tell.
    **Raises** ValueError for what `load_surface` rejects.

    **Example:** an ellipsoid that was moved.

    ```python
    egg = trimesh.creation.icosphere(subdivisions=2).apply_scale([1.0, 1.6, 2.3])
    egg.vertices += 0.1 * egg.vertices**2  # no symmetry is left
    moved = egg.copy().apply_translation([5.0, 0.0, 1.0])
    mr.align(egg, moved)[:3, 3].round(3)  # 5.0, 0.0, 1.0
    ```
    """
    check_x64()
    ours, theirs = given_surface("source", source), given_surface("target", target)
    ours, theirs = _drawn(ours.cloud), _drawn(theirs.cloud)
    length = NORMAL_LENGTH * _size(theirs.points)
    few = (surface.among(slice(FEW)) for surface in (ours, theirs))
    coarse = partial(_closer, *few, length, FIRST)
    runs = [coarse(begun) for begun in _beginnings(ours, theirs)]
    runs = sorted(runs, key=lambda run: run[0])[:KEPT]
    runs = [_closer(ours, theirs, length, LAST, begun) for _, begun in runs]
    (least, best), *others = sorted(runs, key=lambda run: run[0])
    for distance, other in others:
        if distance < ALIKE * least and _angle(best.rotation, other.rotation) > APART:
            warnings.warn(
                "align: another rotation fits about as well (mean distance "
                f"{distance:.3g} and {least:.3g}): look at the result, or give `register` "
                "a start or landmarks.",
                stacklevel=2,
            )
            break
    return best.matrix


def moved_by(start: ArrayLike | None, points: ArrayLike) -> Float[np.ndarray, "n 3"]:
    """By a matrix `(4, 4)`, checked."""
    matrix = as_numbers("start", start)
    if matrix.shape != (4, 4) or not np.all(np.isfinite(matrix)):
        raise ValueError(
            f"start: expected a finite matrix (4, 4), found shape {matrix.shape}; "
            "`mr.align` makes one."
        )
    if not np.allclose(matrix[3], [0, 0, 0, 1]) or np.linalg.det(matrix) <= 0:
        raise ValueError(
            "start: expected an affine map for homogeneous coordinates without a "
            "reflection: last row 0, 0, 0, 1, positive determinant. Is it transposed?"
        )
    return np.asarray(points) @ matrix[:3, :3].T + matrix[:3, 3]


def _drawn(cloud: PointCloud) -> OrientedPoints:
    areas = np.asarray(cloud.areas)
    share = areas / np.sum(areas)
    count = min(POINTS, int(np.sum(share > 0)))
    chosen = np.random.default_rng(0).choice(len(share), count, False, share)
    return oriented(cloud).among(chosen)


def _size(points: Float[np.ndarray, "n 3"]) -> float:
    return radius_of_gyration(points, np.full(len(points), 1 / len(points)))


def _beginnings(ours: OrientedPoints, theirs: OrientedPoints) -> list[Similarity]:
    """Centroid on centroid, size on size, axes on axes in any order and sense."""
    axes = []
    for surface in (ours, theirs):
        centred = surface.points - surface.points.mean(axis=0)
        axes.append(np.linalg.svd(centred, full_matrices=False)[2])
    scale = _size(theirs.points) / _size(ours.points)
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            rotation = (axes[1] * np.array(signs)[:, None]).T @ axes[0][list(order)]
            if np.linalg.det(rotation) > 0:
                centre = scale * rotation @ ours.points.mean(axis=0)
                shift = theirs.points.mean(axis=0) - centre
                found.append(Similarity(scale, rotation, shift))
    return found


def _closer(
    ours: OrientedPoints,
    theirs: OrientedPoints,
    length: float,
    rounds: int,
    first: Similarity,
) -> tuple[float, Similarity]:
    """After so many rounds, with the mean distance of matches. They go both ways: of one
    alone, what shrinks is near."""
    both = lambda here: (matches(here, theirs, length), matches(theirs, here, length))
    here = first.of(ours)
    there, back = both(here)
    for _ in range(rounds):
        first = _next_to(
            np.concatenate([ours.points, first.back(back.points)]),
            np.concatenate([there.points, theirs.points]),
            np.concatenate([there.weights, back.weights]),
        )
        here = first.of(ours)
        there, back = both(here)
    gaps = there.points - here.points, back.points - theirs.points
    return float(np.mean(np.linalg.norm(np.concatenate(gaps), axis=1))), first


def _next_to(x, y, weights) -> Similarity:
    """Of the least weighted squared distance (Umeyama 1991)."""
    share = weights / np.sum(weights)
    centres = share @ x, share @ y
    x, y = x - centres[0], y - centres[1]
    (turn,) = rotations((share[:, None] * x)[None], y)
    scale = float(share @ np.sum((x @ turn) * y, axis=1) / np.sum(share @ x**2))
    return Similarity(scale, turn.T, centres[1] - scale * centres[0] @ turn)


def _angle(a, b) -> float:
    return float(np.arccos(np.clip((np.trace(a.T @ b) - 1) / 2, -1, 1)))
