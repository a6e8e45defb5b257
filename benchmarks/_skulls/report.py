"""The table from the runs."""

from pathlib import Path

import numpy as np
from _paired import paired

from .precision import precision
from .runs import read_runs
from .tasks import SOURCE, TARGETS, fitted, landmarks_of

NAMES = {
    "rbf_r": "scipy RBF, r + closest point (strong baseline)",
    "meshmonk_rigid": "MeshMonk, pyramid, from the rigid motion",
    "meshmonk_warp": "MeshMonk, pyramid, from the RBF warp",
    "drift": "pycpd, coherent point drift, from the RBF warp",
    "landmarks": "**manireg, landmarks alone** (default)",
    "surface": "**manireg, `surface=True`**",
}
BASE = "rbf_r"


def write_report(out: Path) -> None:
    runs = read_runs(out)
    counts = sorted({key[0] for key in runs}, reverse=True)
    parts = [_table(runs, count) for count in counts] + [_digitising()]
    (out / "skulls.md").write_text("\n".join(parts))


def _table(runs, landmarks: int) -> str:
    """The comparison is paired: over the targets that the baseline was run on, too."""
    lines = [
        f"Mouse skulls, {landmarks} landmarks fitted; mean error in mm of the other "
        f"{51 - landmarks}:",
        "",
        "| method | predicted | / baseline | better on | worst skull | fitted | folds | "
        "s a skull | peak GB | skulls |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    base = _of(runs, landmarks, BASE)
    for method, name in NAMES.items():
        own = _of(runs, landmarks, method)
        if not own:
            continue
        column = lambda field, rows=own: np.array(
            [float(r[field]) for r in rows.values()]
        )
        peer = {} if method == BASE else base
        beside = paired(*(_predicted(rows) for rows in (own, peer)))
        row = [
            name,
            f"{column('predicted').mean():.3f}",
            beside.ratio,
            f"{beside.wins} of {beside.targets}" if beside.targets else "",
            f"{column('predicted').max():.3f}",
            f"{column('fitted').mean():.3f}",
            f"{100 * column('folds').mean():.2f} %",
            f"{np.median(column('seconds')):.0f}",
            f"{column('peak_gb').max():.1f}",
            str(len(own)),
        ]
        lines.append("| " + " | ".join(row) + " |")
    return "\n".join([*lines, ""])


def _of(runs, landmarks: int, method: str) -> dict:
    return {k[2]: row for k, row in runs.items() if k[:2] == (landmarks, method)}


def _predicted(rows: dict) -> dict[str, float]:
    return {target: float(row["predicted"]) for target, row in rows.items()}


def _digitising() -> str:
    """How much of the errors is that of the landmarks themselves."""
    found = precision(np.stack([landmarks_of(name) for name in (SOURCE, *TARGETS)]))
    pairs = int(np.sum(np.isfinite(found.deviation))) // 2
    rms = np.sqrt(3 * np.nanmean(found.deviation**2))
    floors = {count: found.floor(~fitted(count)) for count in (36, 13)}
    return (
        "Digitising error, from the scatter of the left-right differences of "
        f"{pairs} pairs over the 6 skulls, their mean taken off: a landmark is "
        f"{rms:.3f} mm off (root mean square), and a perfect map would leave a mean error "
        f"of {floors[36]:.3f} mm in the {np.sum(~fitted(36))} predicted ones, of "
        f"{floors[13]:.3f} mm in the {np.sum(~fitted(13))}. Errors common to both sides "
        "are not in it; true asymmetry that differs between skulls is.\n"
    )
