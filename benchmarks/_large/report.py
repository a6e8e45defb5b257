"""The table from the runs."""

from pathlib import Path

import numpy as np

from .runs import read_runs

NAMES = {
    "sphere1": "sphere to sphere, local linear (degree 1)",
    "sphere2": "sphere to sphere, local quadratic (degree 2, the default)",
    "surface": "neighbourhood of a surface of 200,000 points (`Ambient`) to sphere",
}


def write_report(out: Path) -> None:
    runs = read_runs(out)
    parts = [
        _table(runs, name) for name in NAMES if any(key[0] == name for key in runs)
    ]
    (out / "large.md").write_text("\n".join(parts))


def _table(runs, name: str) -> str:
    rows = [runs[key] for key in sorted(runs) if key[0] == name]
    lines = [
        f"{NAMES[name]}:",
        "",
        "| centres | unknowns | data | make_problem s | solve s | compile s | Newton "
        "steps | s an iteration | of it factorisation | ratio | peak GB |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        ratio = float(row["iteration"]) / float(row["factorisation"])
        names = ("centres", "unknowns", "data", "make_problem", "solve", "compile")
        names += ("newton_steps", "iteration", "factorisation")
        cells = [*(row[n] for n in names), f"{ratio:.2f}", row["peak_gb"]]
        lines.append("| " + " | ".join(cells) + " |")
    if len(rows) > 1:
        K = np.log([float(row["centres"]) for row in rows])
        seconds = np.log([float(r["make_problem"]) + float(r["solve"]) for r in rows])
        ends = (seconds[-1] - seconds[0]) / (K[-1] - K[0])
        lines += [
            "",
            f"make_problem + solve grows like K^{ends:.2f}, first to last row.",
        ]
    return "\n".join([*lines, ""])
