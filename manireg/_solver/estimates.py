"""What a posterior says of velocities: values with how sure they are."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .regions import Region


class Estimate(NamedTuple):
    """A quantity at each of q points, with its covariance."""

    value: Float[np.ndarray, "q ..."]
    covariance: Float[np.ndarray, "q d d"]
    """Of the d coordinates in `frame`, or of the value as it is."""
    frame: Float[np.ndarray, "q t d"] | None = None


class MotionEstimate(NamedTuple):
    """Of a point that moves on the sphere; see `sphere_motion`."""

    speed: Float[np.ndarray, " q"]
    """Radians per unit of x."""
    speed_deviation: Float[np.ndarray, " q"]
    """Standard deviation, likewise."""
    azimuth: Float[np.ndarray, " q"]
    """Degrees from north, clockwise."""
    azimuth_deviation: Float[np.ndarray, " q"]
    euler_pole: Region
