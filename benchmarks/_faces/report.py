"""The table from the runs."""

from pathlib import Path

import numpy as np
from _paired import paired

from .runs import read_runs

NAMES = {
    "rbf_r": "scipy RBF, r + closest point",
    "meshmonk": "MeshMonk, pyramid, from the RBF warp",
    "landmarks": "**manireg, landmarks alone** (default)",
    "surface": "**manireg, `surface=True`**",
}
PEER = "meshmonk"
SEEN = range(1, 8)  # parameters were found on these


def write_report(out: Path) -> None:
    runs = read_runs(out)
    counts = sorted({key[0] for key in runs}, reverse=True)
    (out / "faces.md").write_text("\n".join(_table(runs, count) for count in counts))


def _table(runs, landmarks: int) -> str:
    """The comparison is paired: over the targets that the peer was run on, too."""
    lines = [
        f"SIMPOP faces, {landmarks} landmarks; mean error in mm over the face:",
        "",
        "| method | all | faces 1 to 7 | faces 8 to 14 | 95 % | / MeshMonk | better on | "
        "worst face | folds | s a face | faces |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    peer = _errors(runs, landmarks, PEER)
    for method, name in NAMES.items():
        own = _errors(runs, landmarks, method)
        if not own:
            continue
        rows = [runs[landmarks, method, target] for target in own]
        column = lambda field, rows=rows: np.array([float(r[field]) for r in rows])
        beside = paired(own, {} if method == PEER else peer)
        halves = [[e for t, e in own.items() if (t in SEEN) == seen] for seen in (1, 0)]
        means = [f"{np.mean(half):.3f}" if half else "" for half in halves]
        row = [
            name,
            f"{np.mean(list(own.values())):.3f}",
            *means,
            f"{column('p95').mean():.2f}",
            beside.ratio,
            f"{beside.wins} of {beside.targets}" if beside.targets else "",
            f"{max(own.values()):.3f}",
            f"{100 * column('folds').mean():.3f} %",
            f"{np.median(column('seconds')):.1f}",
            str(len(own)),
        ]
        lines.append("| " + " | ".join(row) + " |")
    return "\n".join([*lines, ""])


def _errors(runs, landmarks: int, method: str) -> dict[int, float]:
    of_method = {k[2]: row for k, row in runs.items() if k[:2] == (landmarks, method)}
    return {target: float(of_method[target]["error"]) for target in sorted(of_method)}
