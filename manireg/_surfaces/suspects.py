"""Landmarks that do not go with the others: swapped, given twice, misplaced.

Each is predicted from all others by the affine map and the kernel r of space, the spline
of least bending in R^3; the left-out residual is `c_i / (A^-1)_ii`, with the coefficients
c of the interpolant and its matrix A (Rippa 1999).
"""

import itertools
import warnings

import numpy as np
from jaxtyping import Float

RIDGE = 1e-6  # smoothing, in units of the mean distance
TOGETHER, APART = 0.02, 0.3  # of the spacing: one place in one set, two in the other
OUTLYING = 3.0  # times the median residual, in units of the spacing: looked at
BETTER = 0.1  # of the squared residuals of two landmarks is left once they are swapped
BEYOND = 6.0  # times the median: misplaced, if farther than the next landmark, too
MOST = 8  # landmarks that are looked at together
FEW, MANY = 8, 500  # numbers of landmarks between which it is done


def warn_of_suspects(
    x: Float[np.ndarray, "l 3"], y: Float[np.ndarray, "l 3"], names
) -> None:
    """In one warning, what landmarks x and their partners y say of each other."""
    told = suspects(x, y, names)
    if told:
        warnings.warn(f"landmarks: {'; '.join(told)}.", stacklevel=4)


def suspects(x, y, names) -> list[str]:
    x, y = _normalised(x), _normalised(y)
    told, kept = [], np.arange(len(x))
    for (a, b), (first, second) in (
        ((x, y), ("source", "target")),
        ((y, x), ("target", "source")),
    ):
        for i, j in _doubled(a, b):
            told.append(
                f"{names[i]!r} and {names[j]!r} are at one place on the {first}, but "
                f"apart on the {second}: is one given twice?"
            )
            kept = np.setdiff1d(kept, [j])
    if not FEW <= len(kept) <= MANY:
        return told
    x, y, names = x[kept], y[kept].copy(), [names[i] for i in kept]
    inverse, spacing = _inverse(x), _spacing(x)
    while (pair := _best_swap(inverse, spacing, y)) is not None:
        i, j = pair
        y[[i, j]] = y[[j, i]]
        told.append(f"{names[i]!r} and {names[j]!r} seem to be swapped in one set")
        if len(told) >= len(names) // 2:
            return told
    residual = left_out(inverse, y)
    ratio = residual / spacing
    worst = int(np.argmax(ratio))
    if ratio[worst] > max(1.0, BEYOND * float(np.median(ratio))):
        rest = np.delete(np.arange(len(x)), worst)
        without = left_out(_inverse(x[rest]), y[rest]) / spacing[rest]
        if np.sum(without**2) < 0.3 * np.sum(ratio**2):
            told.append(
                f"{names[worst]!r} seems misplaced in one set, farther from where the "
                "others predict it than from the next landmark"
            )
    return told


def left_out(inverse, y) -> Float[np.ndarray, " l"]:
    """Lengths of the residuals of each landmark if it is left out."""
    n = len(y)
    return np.linalg.norm(inverse[:n, :n] @ y, axis=1) / np.abs(
        np.diagonal(inverse)[:n]
    )


def _normalised(points):
    points = points - points.mean(axis=0)
    return points / np.sqrt(np.mean(np.sum(points**2, axis=1)))


def _distances(points):
    return np.linalg.norm(points[:, None] - points[None], axis=2)


def _spacing(x) -> Float[np.ndarray, " l"]:
    """Mean distance of the next three."""
    return np.sort(_distances(x), axis=1)[:, 1:4].mean(axis=1)


def _doubled(a, b) -> list[tuple[int, int]]:
    near, far = _distances(a), _distances(b)
    typical = lambda d: np.median(np.sort(d, axis=1)[:, 1])
    close = (near < TOGETHER * typical(near)) & (far > APART * typical(far))
    return [(int(i), int(j)) for i, j in zip(*np.nonzero(np.triu(close, 1)))]


def _inverse(x):
    """Of the matrix of the interpolant; affine in the directions landmarks spread."""
    _, size, axes = np.linalg.svd(x - x.mean(axis=0), full_matrices=False)
    affine = np.c_[np.ones(len(x)), x @ axes[size > 1e-6 * size[0]].T]
    distance = _distances(x)
    kernel = RIDGE * distance.mean() * np.eye(len(x)) - distance
    corner = np.zeros((affine.shape[1],) * 2)
    return np.linalg.pinv(np.block([[kernel, affine], [affine.T, corner]]))


def _best_swap(inverse, spacing, y) -> tuple[int, int] | None:
    before = left_out(inverse, y)
    ratio = before / spacing
    outlying = np.flatnonzero(ratio > OUTLYING * np.median(ratio))
    outlying = outlying[np.argsort(-ratio[outlying])][:MOST]
    found = []
    for i, j in itertools.combinations(outlying.tolist(), 2):
        other = y.copy()
        other[[i, j]] = y[[j, i]]
        after = left_out(inverse, other)
        two = np.sum(after[[i, j]] ** 2) / np.sum(before[[i, j]] ** 2)
        if two < BETTER and np.sum(after**2) < np.sum(before**2):
            found.append((np.sum(after**2), i, j))
    return min(found)[1:] if found else None
