"""Table and pictures from the runs."""

from pathlib import Path

import numpy as np
from _paired import paired

from .runs import read_runs

NAMES = {
    "affine": "affine map + closest point",
    "rbf_r2logr": "scipy RBF, r² log r + closest point",
    "rbf_r": "scipy RBF, r + closest point (strong baseline)",
    "free_solution": "thin plate of the paper (free solution) + closest point",
    "rkhs_warp": "RKHS warp after [12] + closest point",
    "nricp_sumner": "trimesh nricp_sumner",
    "nricp_amberg": "trimesh nricp_amberg",
    "meshmonk": "MeshMonk, pyramid, from the RBF warp",
    "manireg_intrinsic": "**manireg, intrinsic Eells**",
    "manireg_ambient": "**manireg, ambient Eells** (tension 0)",
    "manireg_tension": "**manireg, ambient Eells with tension** (default)",
    "manireg_surface": "**manireg, `surface=True`**",
}
HEADS = {
    "ict": "ICT",
    "makehuman": "MakeHuman",
    "ict_pairs": "ICT, one person onto another",
    "makehuman_pairs": "MakeHuman, one person onto another",
}
BASE = "rbf_r"


def write_report(out: Path) -> None:
    runs = read_runs(out)
    settings = sorted({key[:2] for key in runs}, key=lambda s: (-s[1], s[0]))
    parts = [_table(runs, *setting) for setting in settings]
    (out / "heads.md").write_text("\n".join(parts))
    if (out / "heads_vertices").exists():
        from .pictures import write_pictures

        write_pictures(out)


def _table(runs, data: str, landmarks: int) -> str:
    """Means over the targets that a method was run on. The comparison is paired: over the
    targets that the baseline was run on, too."""
    lines = [
        f"{HEADS[data]}, {landmarks} landmarks; mean error in mm:",
        "",
        "| method | whole | interior | near landmarks | whole / baseline | interior / "
        "baseline | better on | s a head | peak GB | targets |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    base = _of(runs, data, landmarks, BASE)
    for method, name in NAMES.items():
        own = _of(runs, data, landmarks, method)
        if not own:
            continue
        mean = lambda field, rows=own: np.mean([float(r[field]) for r in rows.values()])
        value = lambda rows, field: {t: float(r[field]) for t, r in rows.items()}
        beside = [
            paired(value(own, field), value(base, field))
            for field in ("whole", "interior")
        ]
        wins = " / ".join(str(part.wins) for part in beside)
        better = "" if method == BASE or not beside[0].targets else wins
        peak = max(float(r["peak_gb"]) for r in own.values())
        seconds = np.median([float(r["seconds"]) for r in own.values()])
        errors = [f"{mean(f):.2f}" for f in ("whole", "interior", "near_landmarks")]
        row = [
            name,
            *errors,
            *(part.ratio for part in beside),
            better,
            f"{seconds:.0f}",
            f"{peak:.1f}",
            len(own),
        ]
        lines.append("| " + " | ".join(map(str, row)) + " |")
    return "\n".join([*lines, ""])


def _of(runs, data: str, landmarks: int, method: str) -> dict:
    return {k[3]: row for k, row in runs.items() if k[:3] == (data, landmarks, method)}
