"""From sphere to sphere by a rotation that changes from place to place, with noise: the
example of the R package nprotreg (Di Marzio, Panzera and Taylor 2019), against its local
rotations and against local means.

    python benchmarks/rotations_of_sphere.py

50 points on a spiral over the sphere, y = exp(Phi(eps)) exp(Phi(s(x))) x with the skew
matrix Phi of a vector, s(x) = (exp(2 x_3), -exp(2 x_2), exp(2 x_1)) / 2 and eps normal of
standard deviation 0.25 in each entry. The error is the mean angle between a fitted and the
noiseless map over the whole sphere. Everything is chosen from the data: bandwidths by
leaving one out. A row of `results/rotations_of_sphere.csv` is a fit; `--seeds` and
`--methods` pick some, a second command goes on where the first was stopped.
"""

import argparse
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import pandas as pd
from _table_file import append_row, read_rows
from scipy.spatial.transform import Rotation
from tqdm import tqdm

import manireg as mr

SPHERE = mr.Sphere(2)
DATA, GRID, SEEDS, NOISE = 50, 2000, 20, 0.25
CONCENTRATIONS = np.geomspace(0.1, 1e3, 81)
FIELDS = "method", "seed", "error", "chosen", "warnings", "seconds"
REFERENCE, SEEN = "local means", ", the best seen afterwards"


def spiral(n: int) -> np.ndarray:
    """n points about equally spaced, as those of nprotreg."""
    steps = np.arange(n)
    height = (2 * steps + 1) / n - 1
    radius, angle = np.sqrt(1 - height**2), steps * np.pi * (3 - np.sqrt(5))
    return np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], axis=-1)


def truth(x: np.ndarray) -> np.ndarray:
    s = np.exp(2 * x[:, ::-1]) * [0.5, -0.5, 0.5]
    return Rotation.from_rotvec(s).apply(x)


def data(seed: int) -> tuple[np.ndarray, np.ndarray]:
    x, rng = spiral(DATA), np.random.default_rng(seed)
    noise = Rotation.from_rotvec(NOISE * rng.normal(size=(DATA, 3)))
    return x, noise.apply(truth(x))


def local_rotations(at, x, y, weights) -> np.ndarray:
    """R(a) a for each a in `at`, R(a) the rotation that minimises
    sum_i w_i(a) |y_i - R x_i|^2 (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(np.einsum("ai,im,in->amn", weights, y, x))
    u[..., -1] *= np.linalg.det(u @ vt)[:, None]
    return np.einsum("amn,an->am", u @ vt, at)


def rotation_regression(x, y):
    """nprotreg's estimator, with one term and one round, its defaults: weights
    exp(kappa (a . x_i - 1)), kappa by the mean squared chord to data left out one by one.
    (Its search ends at kappa = 10 by default; here it may go on.)"""
    nearness = x @ x.T - 1

    def left_out(kappa) -> float:
        weights = np.exp(kappa * nearness) * ~np.eye(len(x), dtype=bool)
        return float(np.mean((local_rotations(x, x, y, weights) - y) ** 2))

    kappa = min(CONCENTRATIONS, key=left_out)
    return _rotations(x, y, kappa), f"kappa {kappa:.1f}"


def _rotations(x, y, kappa: float) -> Callable:
    return lambda a: local_rotations(a, x, y, np.exp(kappa * (a @ x.T - 1)))


def local_means(x, y):
    model = mr.baselines.nadaraya_watson(SPHERE, SPHERE, x, y, folds=len(x))
    return model, f"h {float(model.bandwidth):.2f}"


def error(model) -> float:
    """Degrees between the noiseless map and a model, mean over the sphere."""
    grid = spiral(GRID)
    squared = SPHERE.squared_distance(np.asarray(model(grid)), truth(grid))
    return float(np.degrees(np.sqrt(squared)).mean())


def seen_afterwards(fit: Callable, values) -> Callable:
    """Of the fits `(x, y, value)` that of least error: what no rule can know."""

    def method(x, y):
        models = {value: fit(x, y, value) for value in values}
        best = min(models, key=lambda value: error(models[value]))
        return models[best], f"{best:.1e}"

    return method


def means_at(x, y, bandwidth: float):
    return mr.baselines.nadaraya_watson(SPHERE, SPHERE, x, y, bandwidth)


def map_at(order: int) -> Callable:
    return lambda x, y, lam: mr.fit(SPHERE, SPHERE, x, y, lam, order=order)


def smoothed(**options) -> Callable:
    def method(x, y):
        model = mr.fit(SPHERE, SPHERE, x, y, progress=False, **options)
        order = model.problem.energy.order
        return model, f"order {order}, lambda {float(model.lam):.1e}"

    return method


METHODS = {
    REFERENCE: local_means,
    "local rotations": rotation_regression,
    "manireg, order 2": smoothed(order=2),
    "manireg, order auto": smoothed(order="auto"),
    "manireg, order 2, restricted likelihood": smoothed(order=2, criterion="reml"),
    "manireg, order 3, restricted likelihood": smoothed(order=3, criterion="reml"),
    f"local means{SEEN}": seen_afterwards(means_at, np.geomspace(0.15, 0.6, 9)),
    f"local rotations{SEEN}": seen_afterwards(_rotations, CONCENTRATIONS),
    f"manireg, order 2{SEEN}": seen_afterwards(map_at(2), np.geomspace(1e-5, 1e-3, 5)),
}


def run(method: str, seed: int) -> dict[str, object]:
    x, y = data(seed)
    start = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model, chosen = METHODS[method](x, y)
    seconds = time.perf_counter() - start
    names = " ".join(sorted({w.category.__name__ for w in caught}))
    values = method, seed, error(model), chosen, names
    return dict(zip(FIELDS, (*values, seconds), strict=True))


def report(rows: pd.DataFrame) -> str:
    errors = rows.pivot(index="seed", columns="method", values="error")
    errors = errors[[m for m in METHODS if m in errors]]
    means, rotations = errors[REFERENCE], errors["local rotations"]
    seconds = rows.groupby("method")["seconds"].median()
    lines = [
        "# Rotations of the sphere",
        "",
        " ".join(__doc__.split("\n\n")[0].split()),
        "",
        f"{DATA} data, mean angle to the noiseless map in degrees, of draws of the noise; "
        "ratios of mean errors of the same draws, and in how many the error is lower.",
        "",
        "| method | draws | error | over local means | lower | over local rotations | "
        "lower | s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name in errors:
        e = errors[name].dropna()
        sem = e.std(ddof=1) / np.sqrt(len(e))
        cells = [name, str(len(e)), f"{e.mean():.2f} ± {sem:.2f}"]
        for other in (means[e.index], rotations[e.index]):
            lower = f"{(e < other).sum()} of {len(e)}"
            cells += [f"{e.mean() / other.mean():.2f}", lower]
        lines.append("| " + " | ".join([*cells, f"{seconds[name]:.1f}"]) + " |")
    warned = rows[rows["warnings"] != ""]
    found = f"{len(warned)} of {len(rows)} fits warned"
    return "\n".join([*lines, "", found + "."]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    default = Path(__file__).parent / "results"
    parser.add_argument("--out", type=Path, default=default)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=[*METHODS])
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "rotations_of_sphere.csv"
    done = {(row["method"], int(row["seed"])) for row in read_rows(file)}
    todo = [(m, s) for m in options.methods for s in range(options.seeds)]
    for method, seed in tqdm([key for key in todo if key not in done]):
        append_row(file, FIELDS, run(method, seed))
    text = report(pd.read_csv(file, keep_default_na=False))
    (options.out / "rotations_of_sphere.md").write_text(text)


if __name__ == "__main__":
    main()
