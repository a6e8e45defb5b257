import csv
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.mark.slow
def test_line_on_sphere_resumes(tmp_path):
    """One small cell in full; a second command finds nothing left to run."""
    command = [sys.executable, BENCHMARKS / "line_on_sphere.py", "--out", tmp_path]
    cell = "--conventions polar --ks 20 --kappas 1000 --reps 1".split()
    file = tmp_path / "line_on_sphere.csv"
    subprocess.run([*command, *cell], check=True)
    before = file.read_text()
    rows = list(csv.DictReader(before.splitlines()))
    assert len(rows) == 6 and all(0 < float(row["mean_error"]) < 2 for row in rows)
    table = (tmp_path / "line_on_sphere.md").read_text()
    assert "| 20 | 1000 |" in table and "**" in table
    assert (tmp_path / "line_on_sphere_polar.png").stat().st_size > 10_000
    subprocess.run([*command, *cell], check=True)
    assert file.read_text() == before


@pytest.mark.slow
def test_bending_resumes(tmp_path):
    """The splines on one data set; a second command finds nothing left to run."""
    command = [sys.executable, BENCHMARKS / "bending.py", "--out", tmp_path]
    cell = ["--shapes", "roll", "--landmarks", "25", "--seeds", "1"]
    cell += ["--methods", "linear", "thin plate", "affine"]
    file = tmp_path / "bending.csv"
    subprocess.run([*command, *cell], check=True)
    before = file.read_text()
    errors = {r["method"]: r for r in csv.DictReader(before.splitlines())}
    assert len(errors) == 3
    assert 0 < float(errors["thin plate"]["mean_along"]) < 0.02
    assert float(errors["affine"]["mean_error"]) > 0.1
    assert "| roll | 25 |" in (tmp_path / "bending.md").read_text()
    subprocess.run([*command, *cell], check=True)
    assert file.read_text() == before


@pytest.mark.slow
def test_large_resumes(tmp_path):
    """One run in a process of its own; a second command finds nothing left to run."""
    command = [sys.executable, BENCHMARKS / "large.py", "--out", tmp_path]
    cell = ["--problems", "sphere1", "--centres", "100"]
    file = tmp_path / "large.csv"
    subprocess.run([*command, *cell], check=True)
    before = file.read_text()
    (row,) = csv.DictReader(before.splitlines())
    assert row["unknowns"] == "1200" and row["data"] == "2500"
    assert 0 < float(row["loss"]) < 0.01
    assert "| 100 | 1200 |" in (tmp_path / "large.md").read_text()
    subprocess.run([*command, *cell], check=True)
    assert file.read_text() == before


@pytest.mark.slow
def test_gondwana(tmp_path, data_folder):
    """The default choice is within 0.15 degrees of a lambda that the held-out poles
    themselves call good."""
    command = [sys.executable, BENCHMARKS / "gondwana.py", "--out", tmp_path]
    subprocess.run([*command, "--lams", "20"], check=True)
    rows = [
        line.strip("| ").split(" | ")
        for line in (tmp_path / "gondwana.md").read_text().splitlines()
        if line.startswith("| manireg")
    ]
    means = {name.split(" (")[0]: float(mean) for name, mean, *_ in rows}
    assert means["manireg"] <= means["manireg, lambda 20 throughout"] + 0.15


@pytest.mark.slow
def test_polar_wander(tmp_path, data_folder):
    """Australia's poles leave the paths of the sea floor, as they did; four regions hold
    most of a simulated truth."""
    command = [sys.executable, BENCHMARKS / "polar_wander.py", "--out", tmp_path]
    parts = ["--parts", "simulation", "australia", "--repetitions", "4"]
    subprocess.run([*command, *parts], check=True)
    rows = [
        line.strip("| ").split(" | ")
        for line in (tmp_path / "polar_wander.md").read_text().splitlines()
        if line.startswith("| ") and not line.startswith("| |")
    ]
    found = {row[0]: float(row[1]) for row in rows if "over x" in row[0]}
    assert found["pointwise, mean over x"] > 0.6
    mueller = [float(row[2]) for row in rows if row[1] == "Müller et al. 2016"]
    assert len(mueller) == 2 and all(0.2 < inside < 0.6 for inside in mueller)


@pytest.mark.slow
def test_trajectory_resumes(tmp_path, data_folder):
    """Twelve seconds of the flight: better than what goes through the data; a second
    command finds nothing left to run."""
    command = [sys.executable, BENCHMARKS / "trajectory.py", "--out", tmp_path]
    methods = "manireg", "RotationSpline, CubicSpline"
    cell = ["--seconds", "12", "--seeds", "5", "--methods", *methods]
    subprocess.run([*command, *cell], check=True)
    file = tmp_path / "trajectory.csv"
    before = file.read_text()
    ours, spline = csv.DictReader(before.splitlines())
    for name in ("degrees", "cm", "degrees_s", "m_s"):
        assert float(ours[name]) < 0.8 * float(spline[name])
    assert 0.85 < float(ours["pose"]) < 1 and 0.85 < float(ours["velocity"]) < 1
    assert "| manireg |" in (tmp_path / "trajectory.md").read_text()
    subprocess.run([*command, *cell], check=True)
    assert file.read_text() == before
