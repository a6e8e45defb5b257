"""How sure predictions are, as columns of a table."""

import warnings
from typing import Any

import numpy as np
from jaxtyping import Float

from .._solver.readings import angular_velocity
from ..manifolds import Sphere
from .tables import Target, TargetName


def uncertainty(
    posterior: Any,
    target: TargetName,
    there: Target,
    x: np.ndarray,
    level: float,
) -> tuple[list[str], Float[np.ndarray, "q m"]]:
    r"""Names and columns at q inputs, in the unit of the outputs or in degrees, of a
    `Posterior`:

    - on $S^2$, semi-axes of the ellipse that holds the path with `level` percent, the
      azimuth of the longer one (from north, clockwise), and the radius of the circle as
      large; of curves their speed and its standard error;
    - of numbers and angles a standard error each;
    - of rotations R that of the angle about each axis of space: with a tangent vector V,
      $V R^\top$ is $\omega \times$, and $\omega$ that rotation.

    What is not known, of a map through all its data, is NaN, with a warning."""
    names = _names(target, there, level, x.ndim == 1)
    if not names:
        return [], np.zeros((len(x), 0))
    if not np.isfinite(posterior.scale):
        warnings.warn(
            "the map has as many parameters as data: nothing tells how they scatter, so "
            "the columns of its uncertainty are nan. Give --sigma, or a larger --lam.",
            stacklevel=2,
        )
        return names, np.full((len(x), len(names)), np.nan)
    if _is_globe(there):
        region = posterior.region(x, level / 100)
        minor, major = np.degrees(region.semi_axes).T
        columns = [major, minor, region.azimuth, region.theta95]
        if x.ndim == 1:
            motion = posterior.sphere_motion(x)
            speeds = motion.speed, motion.speed_deviation
            columns += [np.degrees(speed) for speed in speeds]
        return names, np.stack(columns, axis=-1)
    covariance, frame = posterior.covariance(x)
    if target == TargetName.rotations:
        frame = _axes(np.asarray(posterior.model(x)), frame)
        covariance = covariance * np.degrees(1.0) ** 2
    elif target == TargetName.circle:
        # one tangent direction, whatever its sign
        frame = np.full((len(x), 1, 1), np.degrees(1.0))
    squares = np.einsum("qta,qab,qtb->qt", frame, covariance, frame)
    return names, np.sqrt(np.maximum(squares, 0.0))


def _names(target: TargetName, there: Target, level: float, curve: bool) -> list[str]:
    if _is_globe(there):
        speed = ["speed", "se_speed"] if curve else []
        return ["semi_major", "semi_minor", "azimuth", theta(level), *speed]
    if target == TargetName.rotations:
        return ["se_x", "se_y", "se_z"]
    if target == TargetName.circle:
        return ["se"]
    if target == TargetName.euclidean:
        return [f"se_{name}" for name in there.columns]
    return []


def theta(level: float) -> str:
    """`theta95`: the name of the radius."""
    return f"theta{level:g}"


def _is_globe(there: Target) -> bool:
    return isinstance(there.manifold, Sphere) and there.manifold.dim == 2


def _axes(
    rotations: Float[np.ndarray, "q 3 3"], frame: Float[np.ndarray, "q 9 3"]
) -> Float[np.ndarray, "q 3 3"]:
    """omega of each vector of the frame."""
    vectors = np.moveaxis(frame.reshape(-1, 3, 3, 3), -1, 1)
    turns = angular_velocity(rotations[:, None], vectors)
    return np.moveaxis(np.asarray(turns), 1, 2)
