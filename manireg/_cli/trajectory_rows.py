"""What `manireg trajectory` prints."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..apps._pose_files import PoseTable
from ..apps._stamps import Stamps
from ..apps._trajectory import Trajectory
from ..apps._trajectory_errors import associated, trajectory_errors

MOST_NAMED = 8  # outliers and gaps


def described(path: Path, data: PoseTable, t: np.ndarray) -> str:
    what = "poses" if data.positions is not None else "orientations"
    columns = f" ({data.read})" if data.read else ""
    span = f"{np.ptp(t):.6g} s, {(len(t) - 1) / np.ptp(t):.4g} Hz"
    return f"{len(t)} {what} of {path.name}{columns}, {span}"


def fitted(found: Trajectory, clock: Stamps) -> dict[str, str]:
    rows, texts = {}, clock.texts()
    for name, part in found.parts.items():
        size, of = (1.0, "m") if name == "position" else (np.degrees(1.0), "degrees")
        rows[f"noise of {name}"] = (
            f"{part.sigma * size:.3g} {of} an axis (order {part.order}; averaged over "
            f"{part.window:.3g} s)"
        )
    lost = [texts[i] for i in found.outliers]
    rows["outliers"] = f"{len(lost)}" + (f": {_some(lost)}" if lost else "")
    gaps = [
        f"{g.start:.6g} to {g.end:.6g} s" + ("" if g.bridged else " (not bridged)")
        for g in found.gaps
    ]
    rows["gaps"] = f"{len(gaps)}" + (f": {_some(gaps)}" if gaps else "")
    return rows


def _some(texts: list[str]) -> str:
    more = len(texts) - MOST_NAMED
    return ", ".join(texts[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def compared(
    found, data: PoseTable, true: PoseTable, t, first, delta
) -> dict[str, str]:
    assert true.stamps is not None
    there = true.stamps.seconds(first)
    inside = np.flatnonzero((there >= t.min()) & (there <= t.max()))
    i, j = associated(t, there[inside])
    if len(i) < 3:
        raise ValueError(
            f"--reference: {len(i)} of its {len(there)} times are within 0.01 s of a "
            "pose. Are both in the same clock and unit (--unit)?"
        )
    j = inside[j]
    smooth = found.after(there[j])
    take = lambda array, index: None if array is None else array[index]
    turn = lambda q: Rotation.from_quat(q, scalar_first=True)
    at = take(true.positions, j), turn(true.quaternions[j])
    versions = {
        "input": (take(data.positions, i), turn(data.quaternions[i])),
        "smoothed": (smooth.positions, turn(smooth.quaternions)),
    }
    rows = {}
    for name, (p, r) in versions.items():
        errors = trajectory_errors(there[j], p, r, *at, delta)
        rows[f"ATE, {name}"] = _pair(errors.ate, errors.ate_degrees)
        rows[f"RPE, {name}"] = _pair(errors.rpe, errors.rpe_degrees)
    rows["compared"] = f"{len(i)} poses; RPE over {delta:g} s; rms"
    return rows


def _pair(metres: float, degrees: float) -> str:
    length = f"{metres:.4g} m, " if np.isfinite(metres) else ""
    return f"{length}{degrees:.4g} degrees"
