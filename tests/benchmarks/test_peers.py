"""Peers that the benchmarks write themselves, against other libraries and closed forms."""

import importlib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module


def unit(rng, n: int) -> np.ndarray:
    x = rng.normal(size=(n, 3))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def test_local_rotations_are_those_of_scipy(benchmark):
    """Also where an orthogonal matrix of determinant -1 would do better: three points."""
    rotations, rng = benchmark("rotations_of_sphere"), np.random.default_rng(0)
    for n in (3, 3, 3, 20):
        x, y, at = unit(rng, n), unit(rng, n), unit(rng, 5)
        weights = rng.uniform(0.1, 1, (5, n))
        found = rotations.local_rotations(at, x, y, weights)
        for a, w, p in zip(at, weights, found, strict=True):
            best = Rotation.align_vectors(y, x, weights=w)[0]
            np.testing.assert_allclose(p, best.apply(a), atol=1e-7)


def test_rotation_regression_finds_a_rigid_rotation(benchmark):
    rotations, rng = benchmark("rotations_of_sphere"), np.random.default_rng(1)
    x, new, turn = unit(rng, 30), unit(rng, 10), Rotation.random(rng=rng)
    noise = Rotation.from_rotvec(0.1 * rng.normal(size=(30, 3)))
    at, _ = rotations.rotation_regression(x, turn.apply(x))
    np.testing.assert_allclose(at(new), turn.apply(new), atol=1e-12)
    at, chosen = rotations.rotation_regression(x, noise.apply(turn.apply(x)))
    apart = np.linalg.norm(at(new) - turn.apply(new), axis=1)
    assert apart.mean() < 0.1 and float(chosen.split()[1]) < 5


def test_turning_of_a_small_circle(benchmark):
    """Total curvature is cot(theta) times the length, at angular distance theta from the
    axis; that of a great circle is zero."""
    paths, phi = benchmark("paths"), np.linspace(0, 3, 2001)
    for theta in (0.3, np.pi / 2):
        ring = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)])
        path = np.vstack([ring, np.full_like(phi, np.cos(theta))]).T
        truth = np.degrees(3 * np.cos(theta))
        np.testing.assert_allclose(paths.turning(path), truth, rtol=1e-3, atol=1e-3)
        assert paths.angles(path[1:], path[:-1]).sum() == pytest.approx(
            np.degrees(3 * np.sin(theta)), rel=1e-6
        )


def test_piecewise_geodesic_is_that_of_spheresmooth(benchmark):
    """Whose loop over times it replaces; without the package, against its definition."""
    peer, rng = benchmark("_spheresmooth"), np.random.default_rng(2)
    points, knots = unit(rng, 6), np.sort(rng.uniform(size=6))
    times = np.sort(rng.uniform(knots[0], knots[-1], 50))
    found = peer.piecewise_geodesic(times, points, knots)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, rtol=1e-12)
    for j in range(5):
        inside = (times >= knots[j]) & (times < knots[j + 1])
        axis = np.cross(points[j], points[j + 1])
        angle = np.arccos(points[j] @ points[j + 1])
        share = (times[inside] - knots[j]) / (knots[j + 1] - knots[j])
        turns = Rotation.from_rotvec(
            np.outer(share * angle, axis / np.linalg.norm(axis))
        )
        np.testing.assert_allclose(found[inside], turns.apply(points[j]), atol=1e-12)


def test_spheresmooth_follows_a_geodesic(benchmark):
    """Two knots and little noise: the geodesic that the data lie on."""
    pytest.importorskip("spheresmooth")
    peer, rng = benchmark("_spheresmooth"), np.random.default_rng(3)
    ages = rng.uniform(100, 300, 30)
    arc = lambda t: np.stack([np.cos(t / 200), np.sin(t / 200), 0 * t], axis=-1)
    y = arc(ages) + 1e-3 * rng.normal(size=(30, 3))
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    path = peer.geodesic_spline(ages, y, (2,))
    new = np.array([290.0, 110.0, 200.0])
    inside = np.clip(new, ages.min(), ages.max())
    assert np.abs(path(new) - arc(inside)).max() < 0.02
