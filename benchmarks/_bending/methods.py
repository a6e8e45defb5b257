"""The methods compared: `(data, centres) -> Fit`. All see the same landmarks and the same
scan; none sees the exact map."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import optimistix as optx
from scipy.interpolate import RBFInterpolator

import manireg as mr

from .data import Data, project


class Fit(NamedTuple):
    image: np.ndarray
    """Of the source's vertices."""
    lam: float = float("nan")
    converged: bool = True


def registered(geometry: str) -> Callable[[Data, int], Fit]:
    def fit(data: Data, centres: int) -> Fit:
        found = mr.register(
            data.source,
            data.target,
            data.landmarks,
            # as positions on the scan: register allows a hundredth of the size
            project(data.target, data.places),
            geometry=geometry,
            tension=0.0,  # holds on to an affine map: not for sheets rolled up
            centres=centres,
            progress=False,
        )
        converged = bool(found.model.result == optx.RESULTS.successful)
        return Fit(found.vertices, float(found.cv.lam), converged)

    return fit


def spline(kernel: str) -> Callable[[Data, int], Fit]:
    """scipy's radial basis functions through the landmarks, then the closest point."""

    def fit(data: Data, centres: int) -> Fit:
        axes = spanned(data.vertices)
        places = project(data.target, data.places)
        inputs = data.vertices[data.landmarks] @ axes
        warp = RBFInterpolator(inputs, places, kernel=kernel, degree=1)
        return Fit(project(data.target, warp(data.vertices @ axes)))

    return fit


def affine(data: Data, centres: int) -> Fit:
    places = project(data.target, data.places)
    ones = lambda x: np.column_stack([x, np.ones(len(x))])
    inputs = ones(data.vertices[data.landmarks])
    linear = np.linalg.lstsq(inputs, places, rcond=None)[0]
    return Fit(project(data.target, ones(data.vertices) @ linear))


def spanned(vertices: np.ndarray) -> np.ndarray:
    """Directions that the source extends in: two for a flat one, where splines of three
    coordinates have no unique solution."""
    _, extents, axes = np.linalg.svd(vertices - vertices.mean(0), full_matrices=False)
    return axes[extents > 1e-9 * extents[0]].T


OURS = {"intrinsic": registered("intrinsic"), "ambient": registered("ambient")}
BASELINES = {
    "linear": spline("linear"),
    "thin plate": spline("thin_plate_spline"),
    "affine": affine,
}
METHODS = BASELINES | OURS
