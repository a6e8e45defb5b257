"""What the commands print."""

from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from .._input.shown import shown

CHOSEN = {
    "error": "cross-validation",
    "gcv": "generalised cross-validation",
    "reml": "restricted likelihood",
}
SCATTER = (
    "degrees of freedom",
    "sigma, found",
    "sigma, taken",
    "phi (reduced chi^2)",
    "tau (scatter added)",
    "log density, left out",
    "weights left",
)


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
    criterion: str = "error",
) -> None:
    """Of a fitted map: for `manireg demo` and `manireg fit`. `unit` is that of
    lambda, where it is known, `order` that of the energy."""
    error = lambda distance: in_degrees(distance, degrees)
    rows = {"data": data}
    by, chosen = CHOSEN[criterion], ""
    if cv is not None:
        chosen = f"({by}, at the end of the grid)" if cv.on_edge else f"({by})"
    if cv is not None and len(cv.paths) > 1:
        tried = ", ".join(str(p) for p in cv.paths)
        rows["order"] = f"{order} (of {tried}, {by})"
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


def noise_rows(posterior: Any, degrees: float | None) -> dict[str, str]:
    """What lambda is in the unit of the inputs, how data scatter about the map, and which
    of them were let go: the part of the summary of a `Posterior` that is not told
    elsewhere."""
    summary = posterior.summary()
    return {"wavelength": f"{summary.wavelength:.3g}"} | {
        name: value
        for name, value in summary.rows(degrees).items()
        if name in SCATTER or name.startswith("note")
    }


def theta_row(name: str, radii: np.ndarray) -> dict[str, str]:
    """Of the column `name`, radii of regions in degrees."""
    low, middle, high = np.quantile(radii, [0, 0.5, 1])
    text = f"{low:.3g} to {high:.3g} degrees, median {middle:.3g}"
    return {f"{name} (path, not poles)": text}


def in_degrees(distance: Any, degrees: float | None) -> str:
    """`degrees` in a unit of distance; None where it has none."""
    if degrees is None:
        return f"{float(distance):.3g}"
    return f"{float(distance) * degrees:.3g} degrees"


def print_rows(rows: dict[str, str], files: list[Path]) -> None:
    """A line each, the files written last."""
    table = Table(show_header=False, box=None, pad_edge=False)
    for name, value in rows.items():
        table.add_row(name, value)
    table.add_row("written", ", ".join(map(str, files)))
    Console(markup=False).print(table)  # names have brackets of their own
