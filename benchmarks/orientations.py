"""Tracks of orientations, time -> rotations, thinned to two a second with noise, judged by
all the orientations in between: two inertial sensors and the flight of a drone.

    python benchmarks/orientations.py

Rotations are unit quaternions on the sphere S^3 here, which has the same minimisers as
SO(3). scipy's RotationSpline goes through the noisy data: it has nothing to choose. The
tracks are found by `MANIREG_DATA`; the table is written to `--out`.
"""

import argparse
from pathlib import Path

import jax
import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline
from tqdm import tqdm

import manireg as mr
from manireg.datasets import data_folder, read_table

TARGET = mr.Sphere(3)
QUATERNION = "qw", "qx", "qy", "qz"
SPACING = 0.5  # seconds
NOISE = 1.0, 3.0  # degrees about each axis
SEEDS = 5
# Of the x-IMU only the number of packets is known: 256 a second is what it sends.
TRACKS = {
    "XSens sensor, 19 s": ("so3_imu_xsens.csv", "time_s", 1.0),
    "x-IMU, hand-held, 25 s": ("so3_imu_xio.csv", "packet", 1 / 256),
    "EuRoC V1_02, drone, 84 s": ("se3_euroc_v102.csv", "t", 1.0),
}


def track(name: str, column: str, seconds: float) -> tuple[np.ndarray, Rotation]:
    table = read_table(data_folder() / "tables" / name)
    times = seconds * (table[column] - table[column][0])
    quaternions = np.stack([table[c] for c in QUATERNION], axis=-1)
    return times, Rotation.from_quat(quaternions, scalar_first=True)


def continuous(rotations: Rotation) -> np.ndarray:
    """Quaternions of which each is next to the one before."""
    q = rotations.as_quat()
    sign = np.sign(np.sum(q[1:] * q[:-1], axis=1))
    return q * np.cumprod(np.append(1.0, np.where(sign == 0, 1.0, sign)))[:, None]


def thinned(times: np.ndarray, truth: Rotation, degrees: float, seed: int):
    """Indices kept, and noisy rotations there."""
    rng = np.random.default_rng([seed, round(10 * degrees)])
    wanted = np.arange(0.0, times[-1] + SPACING / 2, SPACING)
    kept = np.unique(np.argmin(np.abs(times[:, None] - wanted), axis=0))
    noise = np.radians(degrees) * rng.normal(size=(len(kept), 3))
    return kept, truth[kept] * Rotation.from_rotvec(noise)


def smoothed(order):
    """A fit as a function of times."""

    def method(x, y, span):
        source = mr.Interval(*span)
        options = {"order": order, "progress": False}
        cv = mr.leave_one_out(source, TARGET, x, continuous(y), **options)
        return lambda t: Rotation.from_quat(np.asarray(cv.model(t)))

    return method


METHODS = {
    "order chosen": smoothed("auto"),
    "Eells (order 2)": smoothed(2),
    "RotationSpline": lambda x, y, span: RotationSpline(x, y),
}


def held_out(method, times, truth, degrees, seed) -> float:
    """Mean angle in degrees between the data kept."""
    kept, noisy = thinned(times, truth, degrees, seed)
    between = np.setdiff1d(np.arange(kept[0], kept[-1]), kept)
    predict = method(times[kept], noisy, (times[kept[0]], times[kept[-1]]))
    errors = predict(times[between]).inv() * truth[between]
    return float(np.degrees(errors.magnitude()).mean())


def report(errors: dict[tuple[str, float, str], list[float]]) -> str:
    lines = [__doc__.split("\n\n")[0].replace("\n", " ") + "\n"]
    lines += [f"Mean angle in degrees, of {SEEDS} draws of the noise.\n"]
    lines += ["| track | noise | " + " | ".join(METHODS) + " |"]
    lines += ["|---|---" + "|---" * len(METHODS) + "|"]
    for name in TRACKS:
        for degrees in NOISE:
            means = [np.mean(errors[name, degrees, method]) for method in METHODS]
            entries = [f"**{m:.2f}**" if m == min(means) else f"{m:.2f}" for m in means]
            lines.append(f"| {name} | {degrees:g} | " + " | ".join(entries) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    folder = Path(__file__).parent / "results"
    parser.add_argument("--out", type=Path, default=folder)
    out = parser.parse_args().out
    jax.config.update("jax_enable_x64", True)
    errors: dict[tuple[str, float, str], list[float]] = {}
    runs = [(t, n, s) for t in TRACKS for n in NOISE for s in range(SEEDS)]
    for name, degrees, seed in tqdm(runs):
        times, truth = track(*TRACKS[name])
        for method, fit in METHODS.items():
            error = held_out(fit, times, truth, degrees, seed)
            errors.setdefault((name, degrees, method), []).append(error)
    (out / "orientations.md").write_text("# Orientations\n\n" + report(errors))
    print(report(errors))


if __name__ == "__main__":
    main()
