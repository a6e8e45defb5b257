"""What is measured: the curve of the first experiment, and a head."""

from typing import Any, NamedTuple

import jax
import numpy as np

import manireg as mr


class Setup(NamedTuple):
    source: Any
    target: Any
    x: Any
    y: Any
    centres: int
    graded: bool
    tension: float
    lam: float

    def problem(self) -> mr.Problem:
        return mr.make_problem(
            *self[:4], centres=self.centres, graded=self.graded, tension=self.tension
        )


def curve(seed: int = 1000) -> Setup:
    """70 data on the sphere, 60 centres (paper, section 5)."""
    data = mr.datasets.line_on_sphere(jax.random.key(seed), 70, 1000.0)
    return Setup(mr.Interval(0, 1), mr.Sphere(2), data.x, data.y, 60, False, 0.0, 2e-9)


def head(number: int = 0) -> Setup:
    """19,000 source points, 25,000 target points, 55 landmarks, 4,800 unknowns, as
    `register` has them."""
    pair = mr.datasets.heads("ict", number)
    source = mr.Ambient(mr.PointCloud.from_mesh(pair.source))
    landmarks = np.asarray(pair.source.vertices)[pair.source_landmarks]
    target = mr.PointCloud.from_mesh(pair.target)
    places = pair.target_landmarks
    return Setup(source, target, landmarks, places, 400, True, 1.0, 1e-2)
