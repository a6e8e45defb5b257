"""The table of `manireg trajectory`: velocities, and how sure everything is."""

from pathlib import Path

import numpy as np

from .._solver.regions import quantile_radius
from ..apps._stamps import Stamps
from ..apps._trajectory import Motion, Trajectory
from .tables import write_table

AXES = "x", "y", "z"


def motion_table(
    path: Path, found: Trajectory, at: Stamps, motion: Motion, level: float, first
) -> None:
    """Metres, degrees and seconds. `level` in percent."""
    names, columns = [], []
    radius, degrees = quantile_radius(level / 100, 3), np.degrees(1.0)
    for letter, size, values, covariance in (
        ("v", 1.0, motion.velocities, motion.velocity_covariances),
        ("w", degrees, motion.angular_velocities, motion.angular_velocity_covariances),
    ):
        if values is None or covariance is None:
            continue
        variances = np.diagonal(covariance, axis1=1, axis2=2)
        deviations = np.sqrt(np.maximum(variances, 0.0))
        names += [letter + axis for axis in AXES]
        names += [f"se_{letter}{axis}" for axis in AXES]
        columns += [*(size * values.T), *(size * deviations.T)]
    for name, size, covariance in (
        ("position", 1.0, motion.position_covariances),
        ("orientation", degrees, motion.orientation_covariances),
        ("v", 1.0, motion.velocity_covariances),
        ("w", degrees, motion.angular_velocity_covariances),
    ):
        if covariance is not None:
            names.append(f"{name}{level:g}")
            columns.append(size * radius * np.linalg.det(covariance) ** (1 / 6))
    t = at.seconds(first)
    gaps = [gap for gap in found.gaps if not gap.bridged]
    missing = [any(gap.start < s < gap.end for gap in gaps) for s in t]
    names.append("no_data")
    columns.append(np.array(missing, float))
    write_table(path, ["time", *names], [at.texts()], np.stack(columns, axis=1))
