import csv
import importlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def precision(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("_skulls.precision")


def symmetric_shape(rng) -> tuple[np.ndarray, np.ndarray]:
    """20 pairs and 5 points of the middle, in an order and a position of their own."""
    left = rng.normal(size=(20, 3)) * [2, 3, 1] + [3, 0, 0]
    middle = rng.normal(size=(5, 3)) * [0, 3, 1]
    points = np.concatenate([left, left * [-1, 1, 1], middle])
    partner = np.concatenate([np.arange(20, 40), np.arange(20), np.arange(40, 45)])
    order = rng.permutation(45)
    return points[order], np.argsort(order)[partner[order]]


def moved(x, rng) -> np.ndarray:
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return x @ (turn * np.sign(np.linalg.det(turn))) + 10 * rng.normal(size=3)


def test_precision_finds_pairs_and_noise(precision):
    """A common asymmetry is no error; specimens lie anywhere."""
    rng = np.random.default_rng(0)
    shape, partner = symmetric_shape(rng)
    common = 0.1 * rng.normal(size=shape.shape)
    noise = 0.03 * rng.normal(size=(40, *shape.shape))
    specimens = np.stack([moved(shape + common + e, rng) for e in noise])
    found = precision.precision(specimens)
    np.testing.assert_array_equal(found.partner, partner)
    in_middle = partner == np.arange(len(partner))
    np.testing.assert_array_equal(np.isnan(found.deviation), in_middle)
    assert np.sqrt(np.nanmean(found.deviation**2)) == pytest.approx(0.03, rel=0.05)
    between = np.linalg.norm(noise[0::2] - noise[1::2], axis=-1)[:, ~in_middle].mean()
    everything = np.ones(len(partner), bool)
    assert found.floor(everything) == pytest.approx(between, rel=0.07)


def test_precision_refuses_what_has_no_sides(precision):
    shape = np.random.default_rng(1).normal(size=(30, 3))
    with pytest.raises(ValueError, match="not nearly symmetric"):
        precision.precision(np.stack([shape, shape]))


@pytest.mark.slow
def test_skulls_resume(tmp_path, data_folder):
    """The spline onto one skull, against a measurement made apart from this benchmark; a
    second command finds nothing left to run."""
    command = [sys.executable, BENCHMARKS / "skulls.py", "--out", tmp_path]
    cell = "--landmarks 36 --methods rbf_r --targets CAST_EIJ".split()
    file = tmp_path / "skulls.csv"
    subprocess.run([*command, *cell], check=True)
    before = file.read_text()
    (row,) = csv.DictReader(before.splitlines())
    assert float(row["predicted"]) == pytest.approx(0.289, abs=0.002)
    table = (tmp_path / "skulls.md").read_text()
    assert "36 landmarks fitted" in table and "Digitising error" in table
    subprocess.run([*command, *cell], check=True)
    assert file.read_text() == before
