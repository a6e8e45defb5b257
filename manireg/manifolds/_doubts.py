"""Data that are points of a manifold, but hardly those that were meant."""

import functools

import jax.numpy as jnp
import numpy as np

from ._base import AbstractManifold
from ._matrices.spd import SymmetricPositiveDefinite
from ._product import Product


@functools.singledispatch
def doubt(manifold: AbstractManifold, points: np.ndarray) -> str | None:
    """What is odd about `points`, `(k, *point_shape)`, and what may have been meant; for
    a warning, since they may be right. None for most."""
    return None


@doubt.register
def _(manifold: SymmetricPositiveDefinite, points: np.ndarray) -> str | None:
    symmetric = (points + np.swapaxes(points, -1, -2)) / 2
    finite = len(points) > 0 and np.isfinite(points).all()
    if manifold.n < 2 or not finite or not (np.linalg.eigvalsh(symmetric) > 0).all():
        return None
    return (
        f"all {len(points)} points are positive definite themselves. Points of "
        "SymmetricPositiveDefinite are logarithms: if these are the matrices S, convert "
        "them with M.from_matrices(S), and predictions with M.to_matrices. (Logarithms of "
        "matrices with all eigenvalues above 1 look like this, too.)"
    )


@doubt.register
def _(manifold: Product, points: np.ndarray) -> str | None:
    parts = zip(manifold.factors, manifold.split(jnp.asarray(points)), strict=True)
    found = [
        (i, doubt(factor, np.asarray(part))) for i, (factor, part) in enumerate(parts)
    ]
    return next((f"factor {i}: {text}" for i, text in found if text), None)
