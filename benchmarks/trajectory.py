"""The flight of a drone from noisy poses at 10 Hz, judged by its poses and velocities at
50 Hz: EuRoC V1_02, 84 s, with noise of 1 degree about and 2 cm along each axis.

    python benchmarks/trajectory.py

Each method is told how large the noise is and chooses its smoothness by the noisy data
alone. Angular velocities are compared with differences of the true orientations, linear
ones with those of the file. The flight is found by `MANIREG_DATA`; finished runs are kept
in a CSV file beside the table, both in `--out`. The criteria that `mr.apps.trajectory`
chooses by were themselves chosen looking at draws 0 to 4.
"""

import argparse
import time
from pathlib import Path

import jax
import numpy as np
from _table_file import append_row, read_rows
from _trajectory.methods import METHODS
from _trajectory.tracks import Found, Truth, noisy, truth
from scipy.stats import chi2
from tqdm import tqdm

LEVEL = 0.95
SEEDS = 5, 6, 7, 8, 9
ERRORS = "degrees", "cm", "degrees_s", "m_s"
SHARES = "pose", "velocity", "orientation", "position", "angular", "linear"
FIELDS = "method", "seed", *ERRORS, *SHARES, "seconds"


def judged(found: Found, flight: Truth, n: int) -> dict[str, float]:
    """Mean errors at the first n times, and shares of the truth in regions."""
    turn = (found.rotations.inv() * flight.rotations[:n]).as_rotvec()
    move = flight.positions[:n] - found.positions
    rates, linear = flight.twists[:n, :3], flight.twists[:n, 3:]
    off, across = rates - found.twists[:, :3], linear - found.twists[:, 3:]
    mean = lambda v: float(np.mean(np.linalg.norm(v, axis=1)))
    row = {
        "degrees": np.degrees(mean(turn)),
        "cm": 100 * mean(move),
        "degrees_s": np.degrees(mean(off)),
        "m_s": mean(across),
    }
    if found.pose_covariances is not None and found.twist_covariances is not None:
        if found.body:
            move = found.rotations.inv().apply(move)
            own = found.rotations.inv().apply(found.twists[:, 3:])
            across = flight.rotations[:n].inv().apply(linear) - own
        pose, twist = np.hstack([turn, move]), np.hstack([off, across])
        row |= _shares(SHARES[::2], pose, found.pose_covariances)
        row |= _shares(SHARES[1::2], twist, found.twist_covariances)
    return row


def _shares(names, errors: np.ndarray, covariances: np.ndarray) -> dict[str, float]:
    """Of all six numbers, of the first three, of the last."""
    found = {}
    for name, part in zip(names, (slice(0, 6), slice(0, 3), slice(3, 6)), strict=True):
        z, c = errors[:, part], covariances[:, part, part]
        squares = np.sum(z * np.linalg.solve(c, z[:, :, None])[:, :, 0], axis=1)
        found[name] = float(np.mean(squares <= chi2.ppf(LEVEL, z.shape[1])))
    return found


def report(rows: list[dict[str, str]]) -> str:
    seeds = sorted({int(row["seed"]) for row in rows})
    lines = [
        "# A flight",
        "",
        __doc__.split("\n\n")[0].replace("\n", " "),
        "",
        f"Mean errors over all times and {len(seeds)} draws of the noise; shares of the "
        "truth in regions of 95 %: of pose and velocity (six numbers each), in brackets "
        "of rotation and translation alone.",
        "",
        "| method | pose: degrees | cm | velocity: degrees/s | m/s | in region of pose | "
        "of velocity | s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    names = [name for name in METHODS if any(r["method"] == name for r in rows)]
    of = {name: [r for r in rows if r["method"] == name] for name in names}
    value = lambda name, field: np.mean([float(r[field]) for r in of[name]])
    best = {field: min(value(name, field) for name in names) for field in ERRORS}
    for name in names:
        cells = [name]
        for field in ERRORS:
            text = f"{value(name, field):.4g}"
            cells.append(f"**{text}**" if value(name, field) == best[field] else text)
        if of[name][0]["pose"]:
            share = lambda field, name=name: f"{100 * value(name, field):.1f}"
            for whole, first, last in (
                ("pose", "orientation", "position"),
                ("velocity", "angular", "linear"),
            ):
                cells.append(f"{share(whole)} ({share(first)}, {share(last)})")
        else:
            cells += ["", ""]
        lines.append(
            "| " + " | ".join([*cells, f"{value(name, 'seconds'):.0f}"]) + " |"
        )
    wins = [
        f"- {name}: "
        + ", ".join(f"{_lower(of, name, f)} of {len(seeds)}" for f in ERRORS)
        for name in names[1:]
    ]
    more = f"Draws in which the error of {names[0]} is lower than that of:"
    return "\n".join([*lines, "", more, "", *wins, ""])


def _lower(of: dict, name: str, field: str) -> int:
    ours = {r["seed"]: float(r[field]) for r in next(iter(of.values()))}
    return sum(ours[r["seed"]] < float(r[field]) for r in of[name])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    folder = Path(__file__).parent / "results"
    parser.add_argument("--out", type=Path, default=folder)
    parser.add_argument("--seeds", nargs="+", type=int, default=SEEDS)
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--seconds", type=float, default=np.inf, help="of the flight")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "trajectory.csv"
    done = {(row["method"], int(row["seed"])) for row in read_rows(file)}
    wanted = [(m, s) for s in options.seeds for m in options.methods]
    flight = truth(options.seconds)
    for method, seed in tqdm([run for run in wanted if run not in done]):
        data = noisy(flight, seed)
        times = flight.times[flight.times <= data.times[-1]]
        start = time.perf_counter()
        found = METHODS[method](data, times)
        row = {"method": method, "seed": seed, "seconds": time.perf_counter() - start}
        append_row(file, FIELDS, row | judged(found, flight, len(times)))
    (options.out / "trajectory.md").write_text(report(read_rows(file)))


if __name__ == "__main__":
    main()
