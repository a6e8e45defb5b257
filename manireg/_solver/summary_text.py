"""A summary as text: two columns, and the worst data."""

from typing import Any, NamedTuple

import numpy as np

from .._input.shown import listed


def rows_of(summary: Any, degrees: float | None) -> dict[str, str]:
    unit, spread = _Unit(degrees), summary.spread
    rows = {
        "data": f"{summary.k}, on a target of dimension {summary.n}",
        "order": str(summary.order),
        "lambda": f"{summary.lam:.4g} (wavelength {summary.wavelength:.3g})",
        "degrees of freedom": f"{spread.edf:.1f} of {spread.dof} (the smoothest maps "
        f"have {spread.null})",
        "sigma, found": unit(summary.sigma),
    }
    if summary.sigma_given is not None:
        rows["sigma, taken"] = unit(summary.sigma_given)
    rows |= _scatter(summary, unit)
    rows["loss"] = summary.loss
    if summary.scale is not None:
        half, tenth = (int(np.sum(summary.weights < w)) for w in (0.5, 0.1))
        rows["loss"] += f", scale {unit(summary.scale)}"
        rows["weights left"] = f"{half} below a half, {tenth} below a tenth"
    for name, lengths in (
        ("residuals", summary.residuals),
        ("left out", summary.left_out),
    ):
        median, decile, largest, rms = map(unit, lengths)
        rows[name] = f"median {median}, 90 % {decile}, largest {largest}, rms {rms}"
    success = "successful" if summary.successful else "not successful"
    rows["convergence"] = f"{success}, {summary.steps} steps"
    if summary.minima is not None and summary.minima > 1:
        higher = f"{100 * summary.second_minimum:.2g} %"
        rows["starts"] = (
            f"disagree: {summary.minima} minima, the second {higher} higher"
        )
    rows["off the manifold"] = f"{summary.off_manifold:.1e}"
    if summary.unresolved:
        rows["basis"] = (
            f"{summary.unresolved} inputs lie closer than centres and lambda resolve"
        )
    return rows | {f"note {i}": note for i, note in enumerate(summary.notes, 1)}


def _scatter(summary: Any, unit: "_Unit") -> dict[str, str]:
    rows = {}
    if summary.phi is not None:
        rows["phi (reduced chi^2)"] = f"{summary.phi:.3g}"
    if summary.tau is not None:
        rows["tau (scatter added)"] = unit(summary.tau)
    if summary.log_densities is not None:
        factor, additive = summary.log_densities
        other = f"tau {additive:.3f}" if summary.tau else f"as given {additive:.3f}"
        better = "phi" if summary.likelier == "factor" else other.rsplit(" ", 1)[0]
        rows["log density, left out"] = f"phi {factor:.3f}, {other}: {better} likelier"
    return rows


def worst_rows(summary: Any, degrees: float | None) -> list[list[str]]:
    unit, worst = _Unit(degrees), summary.worst
    lines = [["index", "input", "residual", "left out", "in sigma", "weight", "lever"]]
    for i, x, residual, left_out, z, weight, h in zip(*worst, strict=True):
        place = listed(np.array([float(f"{v:.5g}") for v in np.ravel(x)]))
        place = place[1:-1] if np.size(x) == 1 else place
        numbers = f"{z:.2f}", f"{weight:.2f}", f"{h:.2f}"
        lines.append([str(i), place, unit(residual), unit(left_out), *numbers])
    return lines


def text_of(rows: dict[str, str], table: list[list[str]]) -> str:
    width = max(map(len, rows))
    lines = [f"{name:<{width}}  {value}" for name, value in rows.items()]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    title = f"worst {len(table) - 1} data"
    return "\n".join([*lines, "", title, *(_aligned(row, widths) for row in table)])


class _Unit(NamedTuple):
    """How lengths are written."""

    degrees: float | None

    def __call__(self, length: float) -> str:
        if self.degrees is None:
            return f"{length:.3g}"
        return f"{length * self.degrees:.3g}°"


def _aligned(cells: list[str], widths: list[int]) -> str:
    return "  ".join(f"{c:>{w}}" for c, w in zip(cells, widths, strict=True))
