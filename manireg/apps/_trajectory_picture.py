"""The picture of a trajectory: its path from above, residuals, and velocities."""

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from .._solver.regions import quantile_radius
from ..plot._figure import BLUE, COLOURS, GREY, ORANGE, STYLE, figure, matplotlib
from ._trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
else:
    Axes = Figure = Any

POINTS = 1500  # of the curves
ELLIPSES = 300  # of the band
MOST = 0.995  # of the residuals lie well within their panel, others on its edge
AXES = "x", "y", "z"


def trajectory_picture(
    found: Trajectory,
    positions: np.ndarray | None,
    quaternions: np.ndarray | None,
    level: float = 0.95,
) -> Figure:
    """Of `trajectory` and its data (quaternions w, x, y, z): from above with the region of
    `level` of the path, residuals of the data (outliers in orange, what is beyond the
    panel on its edge), linear and angular velocity with bands of `level` each. Gaps that
    the smoother does not bridge are grey."""
    t = found.times
    at = np.linspace(t.min(), t.max(), min(POINTS, max(4 * len(t), 200)))
    motion: Any = found.after(at)
    own: Any = found.after(t)
    with matplotlib().rc_context(STYLE):
        both = found.position is not None and found.orientation is not None
        picture = figure(10.0 if both else 7.4, 4.0 if both else 2.6)
        if both:
            above, *rows = _panels(picture)
        else:
            above, rows = None, list(picture.subplots(1, 2))
        residuals = []
        if found.position is not None and positions is not None:
            if above is not None:
                _from_above(above, motion, positions, found, level)
            gap = 1000 * (positions - own.positions)
            label = "position residual (mm)"
            residuals.append((gap, label, found.position.outliers))
        if found.orientation is not None and quaternions is not None:
            estimate = Rotation.from_quat(own.quaternions, scalar_first=True)
            data = Rotation.from_quat(quaternions, scalar_first=True)
            gap = np.degrees((estimate.inv() * data).as_rotvec())
            label = "orientation residual (°)"
            residuals.append((gap, label, found.orientation.outliers))
        curves = [
            (motion.velocities, motion.velocity_covariances, 1.0, "velocity (m/s)"),
            (
                motion.angular_velocities,
                motion.angular_velocity_covariances,
                np.degrees(1.0),
                "angular velocity (°/s)",
            ),
        ]
        curves = [curve for curve in curves if curve[0] is not None]
        half = len(rows) // 2
        for panel, (gap, label, lost) in zip(rows[:half], residuals):
            _residuals(panel, t, gap, label, lost)
        for panel, curve in zip(rows[half:], curves):
            _curves(panel, at, level, *curve)
        for panel in rows[half:] if both else rows:
            panel.set_xlabel("time (s)")
        for panel in rows:
            for gap in found.gaps:
                if not gap.bridged:
                    panel.axvspan(gap.start, gap.end, color=GREY, alpha=0.25, lw=0)
        rows[half].legend(ncols=3, loc="upper right", handlelength=1.2)
        return picture


def _panels(picture) -> list[Axes]:
    picture.set_layout_engine("none")  # a tall panel of equal axes makes it give up
    margins = {"left": 0.06, "right": 0.99, "bottom": 0.12, "top": 0.97}
    widths = {"width_ratios": [1.35, 1, 1], "wspace": 0.4, "hspace": 0.18}
    grid = picture.add_gridspec(2, 3, **margins, **widths)
    above = picture.add_subplot(grid[:, 0])
    places = (0, 1), (0, 2), (1, 1), (1, 2)
    return [above, *(picture.add_subplot(grid[place]) for place in places)]


def _from_above(panel: Axes, motion: Any, data, found: Trajectory, level) -> None:
    """x to the right, y upwards."""
    from matplotlib.collections import EllipseCollection

    some = np.unique(np.linspace(0, len(motion.positions) - 1, ELLIPSES).astype(int))
    values, vectors = np.linalg.eigh(motion.position_covariances[some, :2, :2])
    axes = 2 * quantile_radius(level, 2) * np.sqrt(np.maximum(values, 0.0))
    angle = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    places = {
        "offsets": motion.positions[some, :2],
        "offset_transform": panel.transData,
    }
    style = {"units": "xy", "facecolors": BLUE, "edgecolors": "none", "alpha": 0.12}
    ellipses = EllipseCollection(axes[:, 1], axes[:, 0], angle, **style, **places)
    panel.add_collection(ellipses)
    lost = np.isin(np.arange(len(data)), found.outliers)
    dots = {"ms": 2.5, "mew": 0, "zorder": 1}
    panel.plot(*data[~lost, :2].T, ".", color=GREY, alpha=0.6, label="data", **dots)
    if lost.any():
        dots |= {"ms": 4, "zorder": 3}
        panel.plot(*data[lost, :2].T, ".", color=ORANGE, label="outliers", **dots)
    panel.plot(*motion.positions[:, :2].T, color=BLUE, lw=1, label="path", zorder=2)
    inside = np.concatenate([motion.positions[:, :2], data[~lost, :2]])
    low, high = inside.min(axis=0), inside.max(axis=0)
    room = 0.06 * max(high - low)
    panel.set(
        xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room)
    )
    panel.set(xlabel="x (m)", ylabel="y (m)")
    panel.set_aspect("equal")
    panel.ticklabel_format(useOffset=False)
    panel.legend(loc="best", handlelength=1.2)


def _residuals(panel: Axes, t, gap, label: str, lost: np.ndarray) -> None:
    kept = ~np.isin(np.arange(len(t)), lost)
    most = 1.5 * np.quantile(np.abs(gap[kept]), MOST)
    for column, colour, name in zip(gap.T, COLOURS, AXES):
        style = {"ms": 2.0, "mew": 0, "alpha": 0.7}
        inside = np.clip(column[kept], -most, most)
        panel.plot(t[kept], inside, ".", color=colour, label=name, **style)
        edge = np.clip(column[lost], -most, most)
        panel.plot(t[lost], edge, ".", color=ORANGE, ms=4, mew=0, clip_on=False)
    panel.axhline(0, color=GREY, lw=0.6, zorder=0)
    panel.set(ylabel=label, ylim=(-most, most))


def _curves(panel: Axes, t, level, values, covariances, factor, label) -> None:
    z = quantile_radius(level, 1)
    for a, (colour, name) in enumerate(zip(COLOURS, AXES)):
        middle = factor * values[:, a]
        half = factor * z * np.sqrt(np.maximum(covariances[:, a, a], 0.0))
        panel.plot(t, middle, color=colour, lw=0.9, label=name)
        panel.fill_between(
            t, middle - half, middle + half, color=colour, alpha=0.2, lw=0
        )
    panel.set(ylabel=label)
