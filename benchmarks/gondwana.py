"""The polar wander path of Gondwana, age -> sphere, from its 194 poles (Torsvik et al.
2012), judged by poles held out: choices of lambda beside the best fixed one.

    python benchmarks/gondwana.py

Ten folds, in each of which every method sees 174 poles only and chooses by them. The fixed
lambda is picked afterwards, by the held-out poles themselves: what no rule can know. The
poles are found by `MANIREG_DATA`; the table is written to `--out`.
"""

import argparse
import functools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import jax
import numpy as np
from tqdm import tqdm

import manireg as mr
from manireg.datasets import data_folder, read_table
from manireg.datasets._tables import directions

POLES, TRAINING, FOLDS = 194, 174, 10
TARGET = mr.Sphere(2)
DEMO = "manireg, the demo: A95, added scatter, restricted likelihood"
LAMS = np.geomspace(0.1, 1e5, 25)  # radians^2 Ma^3


def poles() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ages in Ma, unit vectors, standard deviations by their confidence cones."""
    table = read_table(data_folder() / "tables" / "s2_poles_torsvik2012.csv")
    lat, lon, age, a95 = (
        table[name][table["gondwana"] == 1] for name in ("lat", "lon", "age", "a95")
    )
    return age, directions(lat, lon), np.asarray(mr.from_a95(a95))


def folds() -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Training and test sets."""
    order = np.random.default_rng(0).permutation(POLES)
    for i in range(FOLDS):
        test = order[i::FOLDS]
        yield order[~np.isin(order, test)][:TRAINING], test


def methods(source: mr.Interval, lams: Sequence[float]) -> dict[str, Callable]:
    """Each `(x, y, sigma) -> predict`."""
    fit = functools.partial(mr.fit, source, TARGET, progress=False)
    spline, mean = mr.baselines.projected_thin_plate, mr.baselines.nadaraya_watson
    at = lambda lam: lambda x, y, _: mr.fit(source, TARGET, x, y, lam)
    return {
        "manireg (default: leave-one-out)": lambda x, y, _: fit(x, y),
        "manireg, 10 folds": lambda x, y, _: fit(x, y, folds=10),
        "manireg, restricted likelihood": lambda x, y, _: fit(x, y, criterion="reml"),
        DEMO: lambda x, y, sigma: fit(x, y, sigma=sigma, criterion="reml"),
        "thin plate, 10 folds": lambda x, y, _: spline(source, TARGET, x, y),
        "Nadaraya-Watson, 10 folds": lambda x, y, _: mean(source, TARGET, x, y),
    } | {f"manireg, lambda {lam:.3g} throughout": at(lam) for lam in lams}


def held_out(method: Callable, x, y, sigma) -> tuple[np.ndarray, list]:
    """Degrees between each pole and the map that has not seen it; and the maps."""
    angles, maps = np.full(len(x), np.nan), []
    for training, test in folds():
        maps.append(method(x[training], y[training], sigma[training]))
        predicted = maps[-1](x[test])
        angles[test] = np.sqrt(TARGET.squared_distance(predicted, y[test]))
    return np.degrees(angles), maps


def share_predicted(maps: list, x, y, sigma) -> float:
    """Of the held-out poles those in the 95 % region of a pole as precise as they are."""
    inside = []
    for model, (_, test) in zip(maps, folds(), strict=True):
        scatter, posterior = model.problem.precision.scatter, model.posterior()
        for i in test:
            new = float(np.hypot(sigma[i], scatter))
            region = posterior.region(x[i : i + 1], new=new)
            inside.append(region.contains(y[i : i + 1])[0])
    return float(np.mean(inside))


def judged(errors: np.ndarray, reference: np.ndarray) -> list[str]:
    """Mean, median, rms, and the mean difference to the errors of another method."""
    less = errors - reference
    values = errors.mean(), np.median(errors), np.sqrt(np.mean(errors**2))
    sem = less.std(ddof=1) / np.sqrt(len(less))
    return [*(f"{v:.2f}" for v in values), f"{less.mean():+.2f} ± {sem:.2f}"]


def report(errors: dict[str, np.ndarray], predicted: float) -> str:
    """The methods that choose, and the best of those that do not, with the paired
    difference to it."""
    fixed = [name for name in errors if name.endswith("throughout")]
    best = min(fixed, key=lambda name: errors[name].mean())
    lines = [
        f"{POLES} poles, {FOLDS} folds: held-out angle in degrees.",
        "",
        "| method | mean | median | rms | mean less that of the best lambda |",
        "|---|---|---|---|---|",
    ]
    for name in [name for name in errors if name not in fixed] + [best]:
        seen = " (the best, seen afterwards)" if name == best else ""
        cells = [f"{name}{seen}", *judged(errors[name], errors[best])]
        lines.append("| " + " | ".join(cells) + " |")
    more = (
        f"{100 * predicted:.1f} % of the held-out poles lie in the 95 % region of a new"
    )
    return "\n".join([*lines, "", f"{more} pole that the demo's method predicts.", ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    default = Path(__file__).parent / "results"
    parser.add_argument("--out", type=Path, default=default)
    parser.add_argument("--lams", nargs="+", type=float, default=LAMS.tolist())
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    x, y, sigma = poles()
    todo = methods(mr.Interval(x.min(), x.max()), options.lams)
    found = {name: held_out(todo[name], x, y, sigma) for name in tqdm(todo)}
    errors = {name: angles for name, (angles, _) in found.items()}
    predicted = share_predicted(found[DEMO][1], x, y, sigma)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "gondwana.md").write_text(report(errors, predicted))


if __name__ == "__main__":
    main()
