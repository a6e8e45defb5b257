"""What the surface term is worth: landmarks left out, predicted without it and with it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from .._selection.folds import training_sets
from .landmark_fit import LandmarkFit, errors_at, landmark_fit, unprojected
from .scans import Scans
from .surface_rounds import fit_surface

FOLDS = 5
LEAST = 8  # landmarks, of which six are left to fit


class HeldOut(NamedTuple):
    """Distances between where landmarks left out are sent and where they belong."""

    landmarks: Float[np.ndarray, " l"]
    """By the map of the other landmarks alone."""
    surface: Float[np.ndarray, " l"]
    """By that of the other landmarks and the whole surface."""

    @property
    def surface_is_better(self) -> bool:
        return bool(np.mean(self.surface) < np.mean(self.landmarks))


def check_enough(landmarks: int) -> None:
    if landmarks < LEAST:
        raise ValueError(
            f"surface: 'auto' holds landmarks out and needs {LEAST} of them, found "
            f"{landmarks}; give True or False."
        )


def held_out(scans: Scans, fit: LandmarkFit, centres: int, progress: bool) -> HeldOut:
    """Five folds, with lambda and the rest as in the fit to all landmarks."""
    count = len(scans.y)
    x, of = scans.x[fit.geometry], fit.geometry
    choice = {(of, fit.centres): (fit.tension,)}
    alone, whole = np.zeros(count), np.zeros(count)
    folds = training_sets(np.ones(count), FOLDS, None)
    for inside in tqdm(folds, "held out", disable=not progress, leave=False):
        part, out = scans.among(np.flatnonzero(inside)), ~inside
        model = landmark_fit(part, choice, fit.model.lam, False, False).model
        cloud = scans.pieces[of].cloud
        both = fit_surface(
            cloud,
            scans.onto,
            part.x[of],
            part.y,
            unprojected(model, cloud),
            centres,
            False,
        )
        alone[out] = errors_at(model, x[out], scans.y[out])
        whole[out] = errors_at(both.model, x[out], scans.y[out])
    return HeldOut(alone, whole)
