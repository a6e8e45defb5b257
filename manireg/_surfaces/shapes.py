"""Shapes of equal numbers of points without position, size and rotation: their mean and
their principal components."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .procrustes import procrustes


class ShapeSpace(NamedTuple):
    """Of n shapes `(n, V, 3)`, after generalised Procrustes analysis (Gower 1975)."""

    mean: Float[np.ndarray, "V 3"]
    """Of the mean centroid size."""
    aligned: Float[np.ndarray, "n V 3"]
    """Of the mean centroid size, too."""
    sizes: Float[np.ndarray, " n"]
    """Centroid sizes: roots of the summed squared distances from the centroid."""
    components: Float[np.ndarray, "k V 3"]
    """Of unit length, largest variance first, at most n - 1."""
    scores: Float[np.ndarray, "n k"]
    variances: Float[np.ndarray, " k"]


def shape_space(shapes: Float[np.ndarray, "n V 3"]) -> ShapeSpace:
    """`aligned` is `mean` plus `scores` times `components`. Rotations have no
    reflections; the first shape gives the direction of the mean."""
    found = procrustes(shapes)
    aligned, mean = found.aligned, found.aligned.mean(axis=0)
    offsets = (aligned - mean).reshape(len(shapes), -1)
    # by the small matrix of inner products: there are many points and few shapes
    values, vectors = np.linalg.eigh(offsets @ offsets.T)
    values, vectors = values[::-1], vectors[:, ::-1]
    kept = values[: len(shapes) - 1] > 1e-12 * max(values[0], 1e-300)
    lengths = np.sqrt(values[: len(kept)][kept])
    scores = vectors[:, : len(kept)][:, kept] * lengths
    components = (scores / lengths**2).T @ offsets
    return ShapeSpace(
        mean,
        aligned,
        found.sizes,
        components.reshape(-1, *mean.shape),
        scores,
        lengths**2 / max(len(shapes) - 1, 1),
    )
