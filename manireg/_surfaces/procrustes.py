"""Landmarks of several specimens without their position, size and rotation."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import orthogonal_procrustes

ROUNDS = 100
SETTLED = 1e-10  # change of the mean, of size 1


class Procrustes(NamedTuple):
    mean: Float[np.ndarray, "n s"]
    """Of the mean size of the specimens, turned like the first."""
    spread: float
    """Sum of squared distances to the mean, of specimens of size 1."""


def procrustes(landmarks: Float[np.ndarray, "k n s"]) -> Procrustes:
    """Generalised Procrustes analysis (Gower 1975): specimens are centred, scaled to size
    1 (the root of the sum of squares) and turned towards their mean, never reflected."""
    x = landmarks - landmarks.mean(axis=1, keepdims=True)
    sizes = np.linalg.norm(x, axis=(1, 2))
    x = x / sizes[:, None, None]
    mean = x[0]
    for _ in range(ROUNDS):
        last = mean
        mean = np.mean([a @ _rotation(a, last) for a in x], axis=0)
        mean /= np.linalg.norm(mean)
        if np.linalg.norm(mean - last) <= SETTLED:
            break
    spread = sum(np.sum((a @ _rotation(a, mean) - mean) ** 2) for a in x)
    return Procrustes(mean @ _rotation(mean, x[0]) * sizes.mean(), float(spread))


def _rotation(a, b) -> Float[np.ndarray, "s s"]:
    """That brings a next to b."""
    best, _ = orthogonal_procrustes(a, b)
    if np.linalg.det(best) > 0:
        return best
    u, _, vt = np.linalg.svd(a.T @ b)
    u[:, -1] *= -1
    return u @ vt
