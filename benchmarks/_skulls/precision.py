"""How precise landmarks are, from left and right of nearly symmetric specimens."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import trimesh
from scipy.optimize import linear_sum_assignment

ROUNDS = 50
SYMMETRIC = 0.1  # of the size: root mean square off the mirror image


class Precision(NamedTuple):
    """Of landmarks on several specimens. What both sides share is not in it, and asymmetry
    that differs between specimens is."""

    partner: np.ndarray
    """`(l,)`: the landmark on the other side; itself in the middle."""
    deviation: np.ndarray
    """`(l,)`: standard deviation of a coordinate; NaN in the middle, where mirroring shows
    one direction only."""

    def floor(self, kept: np.ndarray) -> float:
        """Mean distance that a perfect map would leave between the landmarks `kept` of two
        specimens, if errors are normal: those of both meet."""
        return float(np.sqrt(2) * np.sqrt(8 / np.pi) * np.nanmean(self.deviation[kept]))


def precision(specimens: np.ndarray) -> Precision:
    r"""From `(k, l, 3)`. A specimen less its mirror image, relabelled and moved back onto
    it, is $a_{ki}$. With errors of deviation $s_i$ in each coordinate, independent between
    left and right, and a mean asymmetry common to all specimens,

    $$s_i^2 = \frac{1}{6 (k - 1)} \sum_k |a_{ki} - \bar a_i|^2.$$
    """
    partner = mirror_partners(specimens)
    aligned = np.stack([moved_onto(x, specimens[0]) for x in specimens])
    mirrored = aligned * [-1, 1, 1]
    images = [moved_onto(m[partner], x) for m, x in zip(mirrored, aligned, strict=True)]
    asymmetry = aligned - np.stack(images)
    scatter = np.sum(asymmetry.var(axis=0, ddof=1), axis=1)
    deviation = np.where(partner == np.arange(len(partner)), np.nan, scatter / 6) ** 0.5
    return Precision(partner, deviation)


def mirror_partners(specimens: np.ndarray) -> np.ndarray:
    """The pairing of the mean shape with its mirror image, in a principal plane, of the
    least sum of squares; assignment and rigid motion take turns."""
    mean = np.mean([moved_onto(x, specimens[0]) for x in specimens], axis=0)
    mean = mean - mean.mean(axis=0)
    found = []
    for axis in np.linalg.svd(mean)[2]:
        image = mean - 2 * np.outer(mean @ axis, axis)
        for _ in range(ROUNDS):
            squares = np.sum((mean[:, None] - image) ** 2, axis=2)
            partner = linear_sum_assignment(squares)[1]
            image = moved_onto(image[partner], mean)[np.argsort(partner)]
        found.append((np.sum((image[partner] - mean) ** 2), partner))
    squares, partner = min(found, key=lambda pair: pair[0])
    paired = np.array_equal(partner[partner], np.arange(len(partner)))
    if not paired or squares > SYMMETRIC**2 * np.sum(mean**2):
        raise ValueError("landmarks: not nearly symmetric, so left has no right.")
    return partner


def moved_onto(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return rigid_motion(x, y)(x)


def rigid_motion(x: np.ndarray, y: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """The one of least squares, never a reflection (Kabsch 1976)."""
    matrix = trimesh.registration.procrustes(
        x, y, reflection=False, scale=False, return_cost=False
    )
    return lambda points: trimesh.transform_points(points, matrix)
