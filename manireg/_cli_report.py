"""What `manireg demo` and `manireg fit` print of a fitted map."""

from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table


def report(
    data: str,
    model: Any,
    cv: Any,
    degrees: float | None,
    seconds: float,
    files: list[Path],
    more: dict[str, str] | None = None,
) -> None:
    def shown(error) -> str:
        unit = 1.0 if degrees is None else degrees
        return f"{float(error) * unit:.3g}" + ("" if degrees is None else " degrees")

    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_row("data", data)
    chosen = " (cross-validation)" if cv is not None else ""
    table.add_row("lambda", f"{float(model.lam):.4g}{chosen}")
    if cv is not None:
        table.add_row("held-out error, mean", shown(cv.score))
    table.add_row("residual, rms", shown(np.sqrt(model.energies.loss)))
    for name, value in (more or {}).items():
        table.add_row(name, value)
    table.add_row("Eells energy", f"{float(model.energies.eells):.4g}")
    table.add_row("off the manifold", f"{float(model.energies.off_manifold):.1e}")
    table.add_row("time", f"{seconds:.1f} s")
    table.add_row("written", ", ".join(str(file) for file in files))
    Console().print(table)
