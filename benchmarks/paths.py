"""Paths of poles beside spheresmooth: the 194 poles of Gondwana held out in ten folds, and
the published running means of Torsvik et al. (2012), in sample.

    pip install '.[paths]'
    python benchmarks/paths.py

Folds and poles are those of `gondwana.py`. spheresmooth (GPL) fits geodesics between
knots, with a penalty on the jumps of velocity there; its lambda and its number of knots
are those of its own BIC. The tables are found by `MANIREG_DATA`, the report is written
to `--out`, in half an hour.
"""

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import jax
import numpy as np
from _spheresmooth import EXAMPLE, geodesic_spline
from gondwana import FOLDS, POLES, TARGET, held_out, judged, poles
from tqdm import tqdm

import manireg as mr
from manireg.datasets import data_folder, read_table
from manireg.datasets._tables import directions

COUNTS = 3, 4, 5, 6, 8, 10  # knots to choose from, of the poles
MEANS_COUNTS = 3, 4, 5, 6, 7, 8, 10, 15, 20, 30  # and of the running means
OURS = {
    "manireg (default: leave-one-out)": {},
    "manireg, restricted likelihood": {"criterion": "reml"},
}


def methods(source: mr.Interval, counts) -> dict[str, Callable]:
    """Each `(x, y) -> predict`."""
    ours = {
        name: partial(mr.fit, source, TARGET, progress=False, **options)
        for name, options in OURS.items()
    }
    named = {
        "spheresmooth, knots and lambda by its BIC": counts,
        f"spheresmooth, {EXAMPLE} knots as in its example, lambda by its BIC": (
            EXAMPLE,
        ),
    }
    theirs = {name: partial(geodesic_spline, counts=c) for name, c in named.items()}
    return ours | theirs


def of_poles() -> str:
    x, y, sigma = poles()
    rows, errors = [], {}
    todo = methods(mr.Interval(x.min(), x.max()), COUNTS)
    for name, fit in tqdm(todo.items()):
        start = time.perf_counter()
        errors[name], maps = held_out(lambda x, y, _, fit=fit: fit(x, y), x, y, sigma)
        seconds = (time.perf_counter() - start) / FOLDS
        cells = [name, *judged(errors[name], next(iter(errors.values())))]
        cells += [_knots(maps), f"{seconds:.1f}"]
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(
        [
            f"{POLES} poles, {FOLDS} folds: held-out angle in degrees.",
            "",
            "| method | mean | median | rms | mean less the default's | knots | s a fit |",
            "|---|---|---|---|---|---|---|",
            *rows,
        ]
    )


def _knots(maps) -> str:
    counts = [len(m.knots) for m in maps if hasattr(m, "knots")]
    if not counts:
        return ""
    return f"{min(counts)} to {max(counts)}" if len({*counts}) > 1 else f"{counts[0]}"


def of_running_means() -> str:
    """Fits to the means themselves, and the published spline through the same poles."""
    table = read_table(data_folder() / "tables" / "s2_path_torsvik2012.csv")
    ages = table["Age"]
    means = directions(table["Plat1_RM"], table["Plon_RM"])
    spline = directions(table["Plat_Spline"], table["Plon_Spline"])
    paths = {
        "the running means themselves": means,
        "the published spline, of the poles": spline,
    }
    knots = {}
    for name, fit in methods(mr.Interval(ages.min(), ages.max()), MEANS_COUNTS).items():
        model = fit(ages, means)
        paths[name], knots[name] = np.asarray(model(ages)), _knots([model])
    rows = []
    for name, path in paths.items():
        apart = angles(path, means)
        values = apart.mean(), np.sqrt(np.mean(apart**2)), apart.max()
        cells = [name, *(f"{v:.2f}" for v in values)]
        cells += [
            f"{v:.0f}" for v in (angles(path[1:], path[:-1]).sum(), turning(path))
        ]
        rows.append("| " + " | ".join([*cells, knots.get(name, "")]) + " |")
    return "\n".join(
        [
            f"The {len(ages)} running means of {ages.min():g} to {ages.max():g} Ma: "
            "distance of a path to the means, its length, and by how much it turns in "
            "all, from age to age; degrees.",
            "",
            "| path | mean | rms | largest | length | turning | knots |",
            "|---|---|---|---|---|---|---|",
            *rows,
        ]
    )


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Degrees between unit vectors."""
    across = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.degrees(np.arctan2(across, np.sum(a * b, axis=-1)))


def turning(path: np.ndarray) -> float:
    """By how many degrees the geodesics between successive points turn, in all: their
    total curvature."""
    poles = np.cross(path[:-1], path[1:])
    return float(angles(poles[1:], poles[:-1]).sum())


IN_SAMPLE = """
This is in sample and has no truth: a path that goes through every mean has distance zero
and turns most. The means are a running window of 20 Myr every 10 Myr, so that neighbours
share poles and their errors are alike; left-out means are told by their neighbours, errors
and all, and leave-one-out follows them more closely than the poles deserve. Fit the poles,
as above, not their running means.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    default = Path(__file__).parent / "results"
    parser.add_argument("--out", type=Path, default=default)
    out = parser.parse_args().out
    jax.config.update("jax_enable_x64", True)
    out.mkdir(parents=True, exist_ok=True)
    parts = "# Paths of poles", of_running_means(), IN_SAMPLE.strip(), of_poles()
    title, means, remark, held = parts
    text = "\n\n".join([title, held, means, remark])
    (out / "paths.md").write_text(text + "\n")


if __name__ == "__main__":
    main()
