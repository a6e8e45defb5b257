"""Table of `bending.py`: mean errors, and ratios paired by data set."""

from collections.abc import Mapping, Set
from pathlib import Path

import numpy as np

from .data import NEIGHBOURS, NOISE, SOURCE_POINTS, TARGET_POINTS
from .methods import BASELINES, METHODS, OURS
from .runs import Task

Runs = Mapping[Task, Mapping[str, str]]
GOAL = 0.3  # of every spline with projection, on roll and tube
NOTES = f"""\
A flat sheet onto three quarters of a cylinder and onto a roll of 1.5 turns (exact
isometries), a tube swept along three quarters of a circle onto a straight one (exact by
definition: arc length along the centre line and angle around it are kept; no isometry).
Source: {SOURCE_POINTS:,} clean points; target: {TARGET_POINTS:,} points with normal noise
of {NOISE:g} sizes in each coordinate and disturbed normals, quadrics of {NEIGHBOURS}
neighbours. Errors in units of the size (square root of the area), averaged over the
source. intrinsic, ambient: `mr.register`, lambda by leave-one-out over the landmarks;
linear, thin plate: `scipy.interpolate.RBFInterpolator` of degree 1 (in the two coordinates
of a flat source), then the closest point of the scan; affine: least squares, then the
closest point. Left out: non-rigid ICP (trimesh), which needs triangles on the scan.
"""


def write_report(path: Path, runs: Runs, tasks: Set[Task]) -> None:
    missing = sorted(tasks - set(runs))
    cells = sorted(
        {task[:2] for task in runs}, key=lambda c: ("crt".index(c[0][0]), c[1])
    )
    lines = ["# Bending: errors against the exact map", "", NOTES]
    for field, title in (
        ("mean_error", "Mean distance in space"),
        ("mean_along", "Mean distance along the target"),
    ):
        lines += [f"## {title}, in 1/1000 of the size", ""]
        lines += [*error_table(runs, cells, field), ""]
    lines += [
        "## Ratios to the splines",
        "",
        "Error in space of the intrinsic fit over that of the baseline on the same data:",
        "geometric mean over the seeds (smallest to largest).",
        f"**Bold**: at most {GOAL:g}.",
        "",
        *ratio_table(runs, cells),
        "",
    ]
    late = [t for t, r in runs.items() if t.method in OURS and r["converged"] == "0"]
    if late:
        lines += ["## Not converged at the chosen lambda, but counted", ""]
        lines += [f"- {', '.join(map(str, task))}" for task in sorted(late)] + [""]
    if missing:
        lines += ["## Failed or not run", ""]
        lines += [f"- {', '.join(map(str, task))}" for task in missing] + [""]
    path.write_text("\n".join(lines))


def by_seed(runs: Runs, cell, method: str, field="mean_error") -> dict[int, float]:
    return {
        task.seed: float(row[field])
        for task, row in runs.items()
        if (task[:2], task.method) == (cell, method)
    }


def error_table(runs: Runs, cells, field: str) -> list[str]:
    lines = ["| shape | landmarks | seeds | " + " | ".join(METHODS) + " |"]
    lines += ["|---" * (3 + len(METHODS)) + "|"]
    for cell in cells:
        entries = {m: by_seed(runs, cell, m, field) for m in METHODS}
        means = {m: np.mean([*e.values()]) for m, e in entries.items() if e}
        seeds = max(len(e) for e in entries.values())
        texts = [f"{1000 * means[m]:.2f}" if m in means else "" for m in METHODS]
        lines.append(f"| {cell[0]} | {cell[1]} | {seeds} | " + " | ".join(texts) + " |")
    return lines


def ratio_table(runs: Runs, cells) -> list[str]:
    lines = ["| shape | landmarks | " + " | ".join(BASELINES) + " |"]
    lines += ["|---" * (2 + len(BASELINES)) + "|"]
    for cell in cells:
        ours = by_seed(runs, cell, "intrinsic")
        texts = []
        for method in BASELINES:
            theirs = by_seed(runs, cell, method)
            ratios = [ours[s] / theirs[s] for s in sorted(ours.keys() & theirs.keys())]
            if not ratios:
                texts.append("")
                continue
            centre = float(np.exp(np.mean(np.log(ratios))))
            shown = f"**{centre:.2f}**" if centre <= GOAL else f"{centre:.2f}"
            texts.append(f"{shown} ({min(ratios):.2f} to {max(ratios):.2f})")
        lines.append(f"| {cell[0]} | {cell[1]} | " + " | ".join(texts) + " |")
    return lines
