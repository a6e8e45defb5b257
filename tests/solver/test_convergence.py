"""Fits that used to creep, fold or stop early: few steps, and the right minimum."""

import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import manireg as mr

CIRCLE, SPHERE = mr.Sphere(1), mr.Sphere(2)
T = np.linspace(0, 10, 41)
STEPS = 40


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def arc(angle):
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


def objective(model):
    return float(model.energies.loss + model.lam * model.energies.eells)


def converged(problem, lam, steps=STEPS, **options):
    """A fit that ended at a minimum in few steps."""
    model = mr.solve(problem, lam, throw=False, **options)
    assert model.result == optx.RESULTS.successful
    assert int(model.stats["num_steps"]) <= steps
    return model


def direction_by_hour(seed, k=80):
    rng = np.random.default_rng(seed)
    hour = 2 * np.pi * rng.uniform(0, 1, k)
    wind = 0.8 * np.sin(hour) + rng.normal(0, 0.1, k)
    points = lambda a: np.stack([np.cos(a), np.sin(a)], axis=1)
    return points(hour), points(wind)


@pytest.mark.parametrize("k", [40, pytest.param(80, marks=pytest.mark.slow)])
def test_circle_to_circle(k):
    x, y = direction_by_hour(0, k)
    problem = mr.make_problem(CIRCLE, CIRCLE, x, y)
    for lam in (1e-5, 1e-3, 1.0, 100.0):
        model = converged(problem, lam)
    # far too smooth: the mean direction
    angle = np.arctan2(*np.asarray(model(x)).T[::-1])
    np.testing.assert_allclose(angle, angle[0], atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_lambda_of_a_direction_is_chosen(seed):
    x, y = direction_by_hour(seed)
    cv = mr.cross_validate(CIRCLE, CIRCLE, x, y, progress=False)
    truth = 0.8 * np.sin(np.arctan2(x[:, 1], x[:, 0]))
    angle = np.arctan2(*np.asarray(cv.model(x)).T[::-1])
    assert np.sqrt(np.mean((angle - truth) ** 2)) < 0.06


def test_interval_twice_as_long_as_the_data():
    bent = 0.3 * np.sin(T)
    y = np.stack(
        [np.cos(T / 2), np.sin(T / 2) * np.cos(bent), np.sin(T / 2) * np.sin(bent)], 1
    )
    longer = mr.make_problem(mr.Interval(0, 20), SPHERE, T, y)
    for lam, total in ((1e-6, 4.2566e-7), (1e-4, 4.104e-5), (1e-2, 2.6277e-3)):
        model = converged(longer, lam)
        assert abs(objective(model) / total - 1) < 1e-3  # that of an Interval(0, 12)
        # beyond the data the map goes on along a geodesic
        end = np.asarray(model(np.linspace(14.0, 20.0, 5)))
        normal = np.cross(end[0], end[1])
        assert np.max(np.abs(end @ unit(normal))) < 0.02


@pytest.mark.parametrize("length", [5.2, 10.0])
def test_large_lambda_is_geodesic_regression(length):
    """Once and more round the sphere; the free start folds to a point."""
    noise = 0.02 * np.random.default_rng(1).normal(size=(41, 3))
    y = unit(arc(T * length / 10) + noise)
    problem = mr.make_problem(mr.Interval(0, 20), SPHERE, T, y)
    for lam in (1.0, 1e2, 1e4):
        model = converged(problem, lam, steps=60)
        assert objective(model) < 1e-3
        plane = np.linalg.svd(y)[2][2]
        assert np.max(np.abs(np.asarray(model(T)) @ plane)) < 0.02


def test_a_perfect_fit_ends():
    """A constant-speed great circle costs nothing; what is left is rounding."""
    problem = mr.make_problem(mr.Interval(0, 10), SPHERE, T, arc(0.1 * T))
    for lam in (1e-8, 1.0, 1e6):
        model = converged(problem, lam)
        assert objective(model) < 1e-14
        np.testing.assert_allclose(model(T), arc(0.1 * T), atol=1e-7)


def test_all_weights_on_one_half():
    """Folds and weights change the mean; the origin of the map stays."""
    y = jnp.asarray(unit(arc(0.1 * T) + 0.1))
    heavy = np.where(T < 5, 1.0, 0.0)
    problem = mr.make_problem(mr.Interval(0, 10), SPHERE, T, y, weights=heavy)
    half = mr.make_problem(mr.Interval(0, 10), SPHERE, T[T < 5], y[T < 5], centres=41)
    here, there = (converged(p, 1e-3)(T) for p in (problem, half))
    np.testing.assert_allclose(here, there, atol=1e-5)
