"""The polar wander path of Gondwana, age -> sphere, from its 194 poles (Torsvik et al.
2012), judged by poles held out: choices of lambda beside the best fixed one.

    python benchmarks/gondwana.py

Ten folds, in each of which every method sees 174 poles only and chooses by them. The fixed
lambda is picked afterwards, by the held-out poles themselves: what no rule can know. The
poles are found by `MANIREG_DATA`; the table is written to `--out`.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import jax
import numpy as np
from tqdm import tqdm

import manireg as mr
from manireg.datasets import data_folder, read_table

POLES, TRAINING, FOLDS = 194, 174, 10
TARGET = mr.Sphere(2)
LAMS = np.geomspace(0.1, 1e5, 25)  # radians^2 Ma^3


def poles() -> tuple[np.ndarray, np.ndarray]:
    """Ages in Ma, and unit vectors."""
    table = read_table(data_folder() / "tables" / "s2_poles_torsvik2012.csv")
    lat, lon, age = (
        table[name][table["gondwana"] == 1] for name in ("lat", "lon", "age")
    )
    lat, lon = np.radians(lat), np.radians(lon)
    x, y = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon)
    return age, np.stack([x, y, np.sin(lat)], axis=-1)


def folds() -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Training and test sets."""
    order = np.random.default_rng(0).permutation(POLES)
    for i in range(FOLDS):
        test = order[i::FOLDS]
        yield order[~np.isin(order, test)][:TRAINING], test


def methods(source: mr.Interval, lams: Sequence[float]) -> dict[str, Callable]:
    """Each `(x, y) -> predict`."""
    at = lambda lam: lambda x, y: mr.fit(source, TARGET, x, y, lam)
    return {
        "manireg (default: leave-one-out)": at(None),
        "manireg, 10 folds": lambda x, y: mr.fit(source, TARGET, x, y, folds=10),
        "thin plate, 10 folds": lambda x, y: mr.baselines.projected_thin_plate(
            source, TARGET, x, y
        ),
        "Nadaraya-Watson, 10 folds": lambda x, y: mr.baselines.nadaraya_watson(
            source, TARGET, x, y
        ),
    } | {f"manireg, lambda {lam:.3g} throughout": at(lam) for lam in lams}


def held_out(method: Callable, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Degrees between each pole and the map that has not seen it."""
    angles = np.full(len(x), np.nan)
    for training, test in folds():
        predicted = method(x[training], y[training])(x[test])
        angles[test] = np.sqrt(TARGET.squared_distance(predicted, y[test]))
    return np.degrees(angles)


def report(errors: dict[str, np.ndarray]) -> str:
    """The methods that choose, and the best of those that do not."""
    fixed = [name for name in errors if name.endswith("throughout")]
    best = min(fixed, key=lambda name: errors[name].mean())
    lines = [
        f"{POLES} poles, {FOLDS} folds: held-out angle in degrees.",
        "",
        "| method | mean | median | rms |",
        "|---|---|---|---|",
    ]
    for name in [name for name in errors if name not in fixed] + [best]:
        e = errors[name]
        row = e.mean(), np.median(e), np.sqrt(np.mean(e**2))
        seen = " (the best, seen afterwards)" if name == best else ""
        lines.append(f"| {name}{seen} | " + " | ".join(f"{v:.2f}" for v in row) + " |")
    return "\n".join([*lines, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    default = Path(__file__).parent / "results"
    parser.add_argument("--out", type=Path, default=default)
    parser.add_argument("--lams", nargs="+", type=float, default=LAMS.tolist())
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    x, y = poles()
    todo = methods(mr.Interval(x.min(), x.max()), options.lams)
    errors = {name: held_out(todo[name], x, y) for name in tqdm(todo)}
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "gondwana.md").write_text(report(errors))


if __name__ == "__main__":
    main()
