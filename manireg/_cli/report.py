"""What the commands print."""

from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from .._input.shown import shown


def report(
    data: str,
    model: Any,
    cv: Any,
    degrees: float | None,
    seconds: float,
    files: list[Path],
    more: dict[str, str] | None = None,
    unit: str = "",
    order: int = 2,
) -> None:
    """Of a fitted map: for `manireg demo` and `manireg fit`. `unit` is that of
    lambda, where it is known, `order` that of the energy."""

    def error(distance) -> str:
        scale = 1.0 if degrees is None else degrees
        return f"{float(distance) * scale:.3g}" + (
            "" if degrees is None else " degrees"
        )

    rows = {"data": data}
    chosen = "" if cv is None else "(cross-validation)"
    if cv is not None and bool(cv.on_edge):
        chosen = "(cross-validation, at the end of the grid)"
    if cv is not None and len(cv.paths) > 1:
        tried = ", ".join(str(p) for p in cv.paths)
        rows["order"] = f"{order} (of {tried}, cross-validation)"
    rows["lambda"] = " ".join(filter(None, [shown(float(model.lam)), unit, chosen]))
    if cv is not None:
        rows["held-out error, mean"] = error(cv.score)
    rows["residual, rms"] = error(np.sqrt(model.energies.loss))
    rows |= more or {}
    energy = "Eells energy" if order == 2 else f"energy of order {order}"
    rows[energy] = f"{float(model.energies.energy):.4g}"
    rows["off the manifold"] = f"{float(model.energies.off_manifold):.1e}"
    rows["time"] = f"{seconds:.1f} s"
    print_rows(rows, files)


def print_rows(rows: dict[str, str], files: list[Path]) -> None:
    """A line each, the files written last."""
    table = Table(show_header=False, box=None, pad_edge=False)
    for name, value in rows.items():
        table.add_row(name, value)
    table.add_row("written", ", ".join(map(str, files)))
    Console(markup=False).print(table)  # names have brackets of their own
