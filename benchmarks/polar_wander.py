"""How sure polar wander paths are: regions that hold a known truth, poles of Australia
beside the sea floor, and all poles of 320 million years beside a published path.

    python benchmarks/polar_wander.py

Everything by restricted likelihood, `criterion="reml"`. The tables of poles are found by
`MANIREG_DATA`; the report is written to `--out`. Ten minutes.
"""

import argparse
import time
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import ArrayLike
from scipy.spatial.transform import Rotation
from tqdm import tqdm

import manireg as mr
from manireg.datasets import data_folder, read_table

TARGET = mr.Sphere(2)
NORTH, TODAY = [[0.0, 0.0, 1.0]], np.radians(0.1)  # the pole now, and how well known
DATA, KAPPA = 30, 100.0  # of a simulation
COVERED = np.linspace(70, 160, 91)
WINDOWS = (0, 320), (100, 100), (150, 160), (200, 230), (240, 250), (300, 320)
SEEN = np.linspace(0, 60, 121)  # ages of Australia
PREDICTED = {"Müller et al. 2016": "muller2016", "Torsvik et al. 2017": "torsvik2017"}

PARTS = "simulation", "australia", "world"


class Poles(NamedTuple):
    """With what is known of their ages."""

    ages: np.ndarray
    directions: np.ndarray
    a95: np.ndarray
    youngest: np.ndarray
    oldest: np.ndarray

    def fit(self, **options) -> mr.RegressionMap:
        x, y = self.ages, self.directions
        given = {"sigma": mr.from_a95(self.a95), "criterion": "reml", "progress": False}
        source = mr.Interval(0, self.oldest.max())
        return mr.fit(source, TARGET, x, y, **given, **options)

    def fit_latent(self, **options) -> mr.RegressionMap:
        return self.fit(x_min=self.youngest, x_max=self.oldest, **options)


def table(name: str) -> dict[str, np.ndarray]:
    return read_table(data_folder() / "tables" / f"s2_{name}.csv")


def unit_vectors(lat: np.ndarray, lon: np.ndarray) -> np.ndarray:
    lat, lon = np.radians(lat), np.radians(lon)
    x, y = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon)
    return np.stack([x, y, np.sin(lat)], axis=-1)


def degrees_apart(p: ArrayLike, q: ArrayLike) -> np.ndarray:
    return np.degrees(np.sqrt(np.asarray(TARGET.squared_distance(p, q))))


def small_circle(ages: np.ndarray) -> np.ndarray:
    """At 0.6 degrees/Myr around (0, 1, 1), from where the south pole comes by 70 degrees
    around x."""
    start = Rotation.from_rotvec([70, 0, 0], degrees=True).apply([0, 0, -1])
    axis = np.array([0, 1, 1]) / np.sqrt(2)
    turn = 0.6 * (ages - 70)[:, None] * axis
    return Rotation.from_rotvec(turn, degrees=True).apply(start)


def simulation(repetitions: int) -> str:
    """Shares of repetitions in which regions hold the truth."""
    source, truth, inside, bands = mr.Interval(70, 160), small_circle(COVERED), [], []
    for i in tqdm(range(repetitions), "simulation"):
        random = np.random.default_rng([0, i])
        x = np.sort(random.uniform(70, 160, DATA))
        p = small_circle(x)
        v = random.normal(size=p.shape) / np.sqrt(KAPPA)
        v -= np.sum(v * p, axis=1, keepdims=True) * p
        y = np.asarray(jax.vmap(TARGET.exp)(p, v))
        model = mr.fit(source, TARGET, x, y, criterion="reml", progress=False)
        posterior = model.posterior()
        inside.append(posterior.region(COVERED).contains(truth))
        band = posterior.region(COVERED, simultaneous=True)
        bands.append(band.contains(truth))
    share, whole = np.mean(inside, axis=0), np.mean(np.all(bands, axis=1))
    worst = np.argmin(share)
    return f"""## Simulation

A small circle, {DATA} data of kappa = {KAPPA:g}, {repetitions} repetitions: share of \
them in which the 95 % region holds the truth.

| | share |
|---|---|
| pointwise, mean over x | {share.mean():.3f} |
| pointwise, least over x (at {COVERED[worst]:g}) | {share[worst]:.3f} |
| pointwise, largest over x | {share.max():.3f} |
| simultaneous, mean over x | {np.mean(bands):.3f} |
| simultaneous, the whole curve | {whole:.3f} |
"""


def australia() -> Poles:
    """And the pole of today. Normal ages (the table has 2 sigma) become uniform ones of
    the same variance."""
    t = table("poles_australia_cenozoic")
    normal = t["distribution"] == "gaussian"
    half = np.where(normal, np.sqrt(3) * t["sigma2_age"] / 2, np.nan)
    youngest = np.where(normal, t["age"] - half, t["min_age"])
    oldest = np.where(normal, t["age"] + half, t["max_age"])
    ages, youngest, oldest = (np.append(0.0, c) for c in (t["age"], youngest, oldest))
    y = np.concatenate([NORTH, unit_vectors(t["lat"], t["lon"])])
    today = mr.a95_of(TODAY**-2, 1)
    return Poles(ages, y, np.append(today, t["A95"]), youngest, oldest)


def sea_floor(name: str, ages: np.ndarray) -> np.ndarray:
    """The north pole seen from Australia; the table has the south pole."""
    t = table(f"path_australia_{name}")
    path = -unit_vectors(t["lat"], t["lon"])
    path = np.stack([np.interp(ages, t["age"], c) for c in path.T], axis=1)
    return path / np.linalg.norm(path, axis=1, keepdims=True)


def beside_the_sea_floor() -> str:
    poles, rows = australia(), []
    paths = {name: sea_floor(file, SEEN) for name, file in PREDICTED.items()}
    for scatter in ("additive", "factor"):
        model = poles.fit_latent(scatter=scatter)
        posterior, summary = model.posterior(), model.summary()
        region = posterior.region(SEEN)
        band = posterior.region(SEEN, simultaneous=True)
        found = f"tau {np.degrees(summary.tau or 0):.1f} degrees"
        if scatter == "factor":
            found = f"phi {summary.phi:.2f}"
        for name, path in paths.items():
            inside, whole = region.contains(path).mean(), band.contains(path).mean()
            gap = degrees_apart(model(SEEN), path)
            numbers = f"{inside:.2f} | {whole:.2f} | {gap.mean():.1f} | {gap.max():.1f}"
            rows.append(f"| {scatter}, {found} | {name} | {numbers} |")
    rows = "\n".join(rows)
    each = "\n".join(_distance_rows(poles))
    return f"""## Australia and the sea floor

{len(poles.ages) - 1} poles with uncertain ages, and the pole of today; share of 0 to \
60 Ma at which the path predicted from the sea floor lies in the 95 % region, and how far \
it lies from ours, in degrees.

| scatter | sea floor | pointwise | simultaneous | mean gap | largest |
|---|---|---|---|---|---|
{rows}

How far the poles themselves lie from these paths, at the age within their range that \
suits best, in degrees.

| age | A95 | {" | ".join(PREDICTED)} |
|---|---|---|---|
{each}
"""


def _distance_rows(poles: Poles) -> list[str]:
    rows = []
    for age, y, a95, *ends in list(zip(*poles, strict=True))[1:]:
        ages = np.linspace(ends[0], min(ends[1], 60.0), 21)
        gaps = [degrees_apart(y, sea_floor(f, ages)).min() for f in PREDICTED.values()]
        marked = [f"**{g:.1f}**" if g > a95 else f"{g:.1f}" for g in gaps]
        rows.append(f"| {age:.4g} | {a95:g} | {' | '.join(marked)} |")
    return rows


def world() -> Poles:
    """The 705 poles in the coordinates of South Africa. Where no range of ages is given
    the age is taken as known; where no A95 is, that of N directions of median kappa (and
    of median N)."""
    t = table("poles_vaes2023")
    fill = lambda column, other: np.where(np.isfinite(column), column, other)
    youngest, oldest = (fill(t[c], t["age"]) for c in ("min_age", "max_age"))
    n = fill(t["N"], np.nanmedian(t["N"]))
    a95 = fill(t["A95"], mr.a95_of(np.nanmedian(t["K"]), n))
    y = unit_vectors(t["lat"], t["lon"])  # plat, plon: of each plate
    return Poles(np.clip(t["age"], youngest, oldest), y, a95, youngest, oldest)


def beside_the_published() -> str:
    poles, t = world(), table("path_vaes2023")
    ages, published = t["mean_age"], unit_vectors(t["plat"], t["plon"])
    gaps, thetas, heads = [], [], []
    for name, fit in {"latent": poles.fit_latent, "exact": poles.fit}.items():
        start = time.perf_counter()
        model = fit()
        seconds, summary = time.perf_counter() - start, model.summary()
        gaps.append(degrees_apart(model(ages), published))
        thetas.append(model.posterior().region(ages).theta95)
        heads.append(f"{name} ages {seconds:.0f} s, tau {np.degrees(summary.tau):.2f}")
    both = np.hypot(thetas[0], t["V95"])
    largest = np.maximum(thetas[0], t["V95"])
    columns = zip(t["age"], ages, gaps[0], gaps[1], thetas[0], t["V95"], strict=True)
    rows = "\n".join(
        f"| {nominal:g} | {age:.1f} | {gap:.2f}{' *' if gap > max(theta, v95) else ''} | "
        f"{exact:.2f} | {theta:.2f} | {v95:.2f} |"
        for nominal, age, gap, exact, theta, v95 in columns
    )
    return f"""## All poles and the published path

{len(poles.ages)} poles ({"; ".join(heads)} degrees), compared with the running mean of \
Vaes et al. 2023 at the mean age of each window: degrees; a star where the gap exceeds \
both regions ({np.sum(gaps[0] > largest)} of {len(ages)}; {np.sum(gaps[0] > both)} exceed \
the root of the sum of their squares).

| window | mean age | gap | gap, ages exact | theta95 | V95 |
|---|---|---|---|---|---|
{rows}

Root mean square gap {np.sqrt(np.mean(gaps[0] ** 2)):.2f} degrees.
{_running_means(t)}
"""


def _running_means(t: dict[str, np.ndarray]) -> str:
    """How much of the gap is what poles weigh: that of their running means, with all alike
    or by the number of directions, as in the published mean of sites."""
    poles, published = world(), unit_vectors(t["plat"], t["plon"])
    columns = table("poles_vaes2023")
    counts = np.nan_to_num(columns["N"], nan=1.0)
    width = np.maximum(poles.oldest - poles.youngest, 1e-3)
    weighed = {
        "all alike": np.ones(len(counts)),
        "by N": counts,
        "by N, only those with K": counts * np.isfinite(columns["K"]),
    }
    rows = []
    for name, weights in weighed.items():
        gaps = []
        for age, truth in zip(t["age"], published, strict=True):
            ends = (
                np.minimum(poles.oldest, age + 10),
                np.maximum(poles.youngest, age - 10),
            )
            share = np.clip((ends[0] - ends[1] + 1e-3) / width, 0, 1)
            mean = (share * weights) @ poles.directions
            gaps.append(degrees_apart(mean / np.linalg.norm(mean), truth))
        gaps = np.array(gaps)
        parts = [gaps[(a <= t["age"]) & (t["age"] <= b)] for a, b in WINDOWS]
        rms = [f"{np.sqrt(np.mean(part**2)):.1f}" for part in parts]
        rows.append(f"| {name} | {' | '.join(rms)} |")
    heads = " | ".join(f"{a} to {b}" if a < b else f"{a}" for a, b in WINDOWS)
    rows = "\n".join(rows)
    return f"""
Why they differ: the published path is a mean of single sites (its N), in which a study of
500 weighs as much as fifty of ten. Here poles scatter by tau, whatever their N, and count
about alike. And 306 poles of the table have no K, so that no sites can be drawn for them.
Running means over 20 Myr of these poles, weighed in three ways, lie from the published
path (root mean square over windows, degrees):

| poles weighed | {heads} |
|---|{"---|" * len(WINDOWS)}
{rows}

Both together explain nearly all of the gap at 100 and 200 to 230 Ma, more than half of it
at 240 and 250 Ma, and about half at 150 and 160 Ma and at the end of the table, from 300
Ma on, where poles are few."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    default = Path(__file__).parent / "results"
    parser.add_argument("--out", type=Path, default=default)
    parser.add_argument("--repetitions", type=int, default=200)
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    written = {
        "simulation": lambda: simulation(options.repetitions),
        "australia": beside_the_sea_floor,
        "world": beside_the_published,
    }
    parts = [written[part]() for part in PARTS if part in options.parts]
    options.out.mkdir(parents=True, exist_ok=True)
    text = "# How sure polar wander paths are\n\n" + "\n".join(parts)
    (options.out / "polar_wander.md").write_text(text)


if __name__ == "__main__":
    main()
