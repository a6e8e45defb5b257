"""Tension: the cost of first derivatives on ambient sources."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import manireg as mr
from manireg._objective.energies import Tension
from manireg._objective.hessian import exact, gauss_newton
from manireg._objective.objective import objective
from manireg._objective.sites import Stage

SPHERE, SPACE = mr.Sphere(2), mr.Euclidean(3)
X = np.asarray(SPHERE.random_points(jax.random.key(0), 15))
WEIGHTS = np.linspace(1.0, 2.0, 15)
STRETCH = np.array([[1.0, 0.3, 0.0], [-0.2, 0.8, 0.1], [0.0, 0.2, 1.3]])
WILD = X @ STRETCH + 0.2 * np.random.default_rng(0).normal(size=X.shape)


def problem(tension, y, target=SPACE, x=X):
    return mr.make_problem(
        mr.Ambient(SPHERE), target, x, y, weights=WEIGHTS, centres=25, tension=tension
    )


@pytest.mark.parametrize("target", [SPACE, SPHERE])
def test_hessians(target):
    taut = problem(2.0, target.project(jnp.asarray(WILD)), target)
    stage = Stage(taut, 1e-2, 0.1, taut.energy)
    size = stage.problem.pattern.size
    w = jax.random.normal(jax.random.key(1), (size, 3))
    dense = jax.jit(jax.hessian(lambda w: objective(w, stage)[0]))(w)
    dense = dense.reshape(w.size, w.size)
    scale = float(jnp.max(jnp.abs(dense)))
    np.testing.assert_allclose(exact(w, stage).as_matrix(), dense, atol=1e-13 * scale)
    model = gauss_newton(w, stage).as_matrix()
    assert np.linalg.eigvalsh(model)[0] > -1e-13 * scale
    if target is SPACE:
        np.testing.assert_allclose(model, dense, atol=1e-13 * scale)


def test_affine_maps_cost_nothing():
    y = X @ STRETCH + 1.0
    model = mr.solve(problem(1.0, y), 1e3)
    np.testing.assert_allclose(model(X), y, atol=1e-6)
    assert model.energies.eells < 1e-12


def test_between_the_spline_and_the_affine_map():
    """Without tension the spline; under all the tension of the world the weighted least
    squares map."""
    root = np.sqrt(WEIGHTS)[:, None]
    ones = np.column_stack([X, np.ones(len(X))])
    affine = ones @ np.linalg.lstsq(root * ones, root * WILD, rcond=None)[0]
    spline = mr.solve(problem(0.0, WILD), 1e-3)(X)
    gap = lambda tension: float(
        np.abs(mr.solve(problem(tension, WILD), 1e-3)(X) - affine).max()
    )
    gaps = [gap(tension) for tension in (1e-9, 1.0, 1e9)]
    assert gaps[0] == pytest.approx(np.abs(spline - affine).max(), rel=1e-4)
    assert gaps[0] > 1.05 * gaps[1]
    assert gaps[2] < 1e-6


def test_data_in_a_plane_say_nothing_across_it():
    flat = np.asarray(SPHERE.project(jnp.asarray(X * np.array([1.0, 1.0, 0.0]))))
    energy = problem(1.0, WILD, x=flat).energy
    assert isinstance(energy, Tension)
    np.testing.assert_allclose(energy.derivative[2], 0.0, atol=1e-9)


@pytest.mark.parametrize("tension", [-1.0, np.nan])
def test_negative_tension_is_refused(tension):
    with pytest.raises(ValueError, match="tension: must be finite and at least 0"):
        problem(tension, WILD)


def test_tension_needs_an_ambient_source():
    with pytest.raises(ValueError, match=r"take Ambient\(source\)"):
        mr.make_problem(SPHERE, SPACE, X, WILD, tension=1.0)
