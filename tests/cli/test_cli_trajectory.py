"""`manireg trajectory` on files as robots write them."""

import csv
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from manireg._cli.app import app
from manireg.apps import read_poses

FIRST = 1403715524907143168
T = np.linspace(0, 3, 61)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flight")
    rng = np.random.default_rng(0)
    places = np.stack([np.cos(T), np.sin(T), 0.2 * T], axis=1)
    turns = Rotation.from_rotvec(np.outer(T, [0, 0, 1.0]))
    noisy = places + 0.01 * rng.normal(size=places.shape)
    noisy[20] += [0.3, 0.2, 0]
    tilted = turns * Rotation.from_rotvec(0.01 * rng.normal(size=(61, 3)))
    stamps = [FIRST + round(1e9 * t) + 7 for t in T]
    keep = np.delete(np.arange(61), np.arange(40, 44))
    write = lambda path, p, r, kept: path.write_text(
        "#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z []\n"
        + "".join(
            ",".join([str(stamps[i]), *map(repr, [*p[i].tolist(), *r[i].tolist()])])
            + "\n"
            for i in kept
        )
    )
    write(folder / "poses.csv", noisy, tilted.as_quat(scalar_first=True), keep)
    write(folder / "truth.csv", places, turns.as_quat(scalar_first=True), range(61))
    return folder, stamps, places


def run(*arguments):
    result = CliRunner().invoke(app, ["trajectory", *map(str, arguments)])
    if result.exit_code == 1:  # a mistake of ours
        raise result.exception or AssertionError(result.output)
    return result.exit_code, " ".join(result.output.split())


@pytest.mark.slow
def test_a_flight(files):
    folder, stamps, places = files
    code, text = run(
        folder / "poses.csv",
        *("--reference", folder / "truth.csv", "--delta", "0.5", "--order", "3"),
        *("--out", folder / "smooth.csv", "--table", folder / "motion.csv"),
        *("--picture", folder / "flight.png"),
    )
    assert code == 0, text
    assert f"outliers 1: {stamps[20]}" in text
    assert "gaps 1: 1.95 to 2.2 s" in text
    smooth: Any = read_poses(folder / "smooth.csv")
    # the four that were missing are back, at their time to the nanosecond
    assert smooth.stamps.texts() == [str(stamp) for stamp in stamps]
    gap = np.linalg.norm(smooth.positions - places, axis=1)
    assert gap.mean() < 0.01
    numbers = dict(zip(*_errors(text)))
    assert numbers["ATE, smoothed"] < 0.8 * numbers["ATE, input"]
    assert numbers["RPE, smoothed"] < 0.8 * numbers["RPE, input"]
    with (folder / "motion.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["time"] for row in rows] == [str(stamp) for stamp in stamps]
    column = lambda name: np.array([float(row[name]) for row in rows])
    speed = np.sqrt(column("vx") ** 2 + column("vy") ** 2 + column("vz") ** 2)
    np.testing.assert_allclose(speed[5:-5].mean(), np.sqrt(1.04), rtol=0.03)
    np.testing.assert_allclose(column("wz")[5:-5].mean(), np.degrees(1.0), rtol=0.05)
    assert np.all(column("v95") > column("se_vx"))
    assert (folder / "flight.png").stat().st_size > 20_000


def _errors(text):
    names = [f"{e}, {v}" for v in ("input", "smoothed") for e in ("ATE", "RPE")]
    return names, [float(text.split(name + " ")[1].split(" m")[0]) for name in names]


def test_mistakes(files):
    folder, *_ = files
    code, text = run(folder / "poses.csv")
    assert code == 2 and "Give --out, --table, --picture or --reference" in text
    out = "--out", folder / "poses.csv"
    code, text = run(folder / "poses.csv", *out)
    assert code == 2 and "is a table to read" in text
    kitti = folder / "kitti.txt"
    kitti.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 5)
    code, text = run(kitti, "--out", folder / "o.txt")
    assert code == 2 and "has no times: give --input-rate" in text
    code, text = run(
        folder / "poses.csv", "--out", folder / "o.csv", "--rate", 9, "--times", kitti
    )
    assert code == 2 and "--rate, --times: give one" in text
