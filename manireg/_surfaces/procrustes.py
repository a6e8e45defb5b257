"""Points of several specimens without their position, size and rotation."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

MOST = 100  # rounds
SETTLED = 1e-10  # change of the mean, of size 1


class Procrustes(NamedTuple):
    """Specimens after generalised Procrustes analysis (Gower 1975), turned like the
    first of them."""

    aligned: Float[np.ndarray, "k n s"]
    """Centred, of the mean size."""
    sizes: Float[np.ndarray, " k"]
    """Centroid sizes: roots of the summed squared distances from the centroid."""
    mean: Float[np.ndarray, "n s"]
    """Of the mean size, too."""
    spread: float
    """Sum of squared distances to the mean, of specimens of size 1."""


def procrustes(specimens: Float[np.ndarray, "k n s"]) -> Procrustes:
    """Specimens are centred, scaled and turned towards their mean, never reflected.

    **Raises** ValueError where all points of one are at one place."""
    x = specimens - specimens.mean(axis=1, keepdims=True)
    sizes = np.linalg.norm(x, axis=(1, 2))
    if not np.all(sizes > 0):
        raise ValueError(f"shapes: all points of {np.argmin(sizes)} are at one place.")
    x = x / sizes[:, None, None]
    mean = x[0]
    for _ in range(MOST):
        last, mean = mean, np.mean(x @ rotations(x, mean), axis=0)
        mean = mean / np.linalg.norm(mean)
        if np.linalg.norm(mean - last) <= SETTLED:
            break
    (turn,), size = rotations(mean[None], x[0]), sizes.mean()
    mean = mean @ turn
    aligned = x @ rotations(x, mean)
    spread = float(np.sum((aligned - mean) ** 2))
    return Procrustes(size * aligned, sizes, size * mean, spread)


def rotations(x, b) -> Float[np.ndarray, "k s s"]:
    """That bring each of x closest to b, from the right (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(np.einsum("kni,nj->kij", x, b))
    hand = np.linalg.det(u @ vt) < 0
    u[hand, :, -1] *= -1
    return u @ vt
