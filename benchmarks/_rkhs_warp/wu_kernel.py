"""Compactly supported kernels and where to put them."""

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.spatial import KDTree


def wu(r: np.ndarray) -> np.ndarray:
    r"""$(1 - r)_+^4 (1 + 4 r + 3 r^2 + \tfrac34 r^3)$: twice differentiable, positive
    definite on $\mathbb{R}^3$ (Wu 1995), 1 at 0."""
    return np.maximum(1 - r, 0) ** 4 * (1 + r * (4 + r * (3 + 0.75 * r)))


def kernel_matrix(
    points: Float[np.ndarray, "n 3"], centres: Float[np.ndarray, "c 3"], width: float
) -> sp.csr_array:
    """`wu(|x_i - c_j| / width)`."""
    pairs = KDTree(points).sparse_distance_matrix(
        KDTree(centres), width, output_type="ndarray"
    )
    shape = (len(points), len(centres))
    return sp.csr_array((wu(pairs["v"] / width), (pairs["i"], pairs["j"])), shape=shape)


def centres_around(
    landmarks: Float[np.ndarray, "l 3"],
    surface: Float[np.ndarray, "n 3"],
    spacing: float,
) -> Float[np.ndarray, "c 3"]:
    """All landmarks, so that they can be met, and points of the surface, each the
    farthest from those before, until all of it is within `spacing`."""
    gap, chosen = KDTree(landmarks).query(surface)[0], []
    while gap.max() > spacing:
        chosen.append(surface[np.argmax(gap)])
        gap = np.minimum(gap, np.linalg.norm(surface - chosen[-1], axis=1))
    return np.concatenate([landmarks, np.reshape(chosen, (-1, 3))])


class Displacement:
    r"""$x \mapsto A x + b$, then $x \mapsto x + \sum_l \sum_i \alpha^l_i
    k(|x - c^l_i| / s_l)$."""

    def __init__(self, matrix, shift, levels: Sequence[tuple]):
        self.matrix, self.shift, self.levels = matrix, shift, levels

    def __call__(self, x: np.ndarray) -> np.ndarray:
        start = x @ self.matrix.T + self.shift
        moved = start.copy()
        for centres, width, alpha in self.levels:
            moved += kernel_matrix(start, centres, width) @ alpha
        return moved
