"""Whoever's basis averages detail out is told; noise alone is no detail."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import manireg as mr
from manireg._objective.resolution import warn_where_coarse

LINE, UNIT = mr.Euclidean(1), mr.Interval(0, 1)
K = 1500
X = np.random.default_rng(0).random(K)
NOISE = 0.1 * np.random.default_rng(1).normal(size=K)
SLOW, FAST = np.sin(8 * X), np.sin(1000 * X)
FINE = 1e-14  # a lambda whose wavelength is shorter than the spacing of 32 centres


def told(fit, *args, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = fit(*args, **options)
    assert all(w.category is mr.ResolutionWarning for w in caught)
    return [str(w.message) for w in caught], found


def of_curve(y, centres=32, x=X, **options):
    return mr.make_problem(UNIT, LINE, x, y[:, None], centres=centres, **options)


def test_a_fast_oscillation_is_named():
    (message,), model = told(mr.solve, of_curve(FAST + NOISE), FINE)
    assert message.startswith("centres: the basis limits the fit, not lam = 1e-14")
    assert "32 centres" not in message  # as many as there are: 33
    assert "Give more `centres`: up to 640" in message
    rms = lambda model: np.sqrt(np.mean((np.ravel(model(X)) - FAST) ** 2))
    assert rms(model) > 0.6
    messages, model = told(mr.solve, of_curve(FAST + NOISE, 600), FINE)
    assert not messages and rms(model) < 0.2


@pytest.mark.parametrize("lam", [1e-16, FINE, 1e-6])
def test_noise_is_no_detail(lam):
    assert not told(mr.solve, of_curve(SLOW + NOISE), lam)[0]
    assert not told(mr.solve, of_curve(NOISE), lam)[0]


def test_what_is_missed_but_small_is_not_told():
    assert not told(mr.solve, of_curve(SLOW), FINE)[0]
    assert not told(mr.solve, of_curve(SLOW + 1e-3 * FAST), FINE)[0]
    assert told(mr.solve, of_curve(SLOW + 0.1 * FAST), FINE)[0]


def test_smoothing_that_is_asked_for_is_not_told():
    assert not told(mr.solve, of_curve(FAST + NOISE), 1e-3)[0]
    problem = of_curve(FAST + NOISE)
    choice = told(mr.leave_one_out, problem, [1e-3, 1e-1], progress=False)
    assert not choice[0]


def test_a_chosen_lambda_is_no_excuse():
    """Whatever it is: large ones may be chosen as the basis follows nothing."""
    options = {"progress": False}
    (message,), _ = told(mr.leave_one_out, of_curve(FAST + NOISE), **options)
    assert "Give more `centres`" in message
    assert not told(mr.leave_one_out, of_curve(SLOW + NOISE), **options)[0]


def test_pairs_given_twice_are_no_detail():
    twice = np.tile(SLOW + NOISE, 2)
    assert not told(mr.solve, of_curve(twice, x=np.tile(X, 2)), FINE)[0]


def test_data_without_weight_are_not_looked_at():
    weights = np.arange(K) < K // 2
    y = np.where(weights, SLOW, FAST) + NOISE
    problem = of_curve(y, weights=weights.astype(float))
    assert not told(mr.solve, problem, FINE)[0]


def test_the_unit_of_outputs_does_not_matter():
    for unit in (1e-9, 1e9):
        assert told(mr.solve, of_curve(unit * (FAST + NOISE) + unit), FINE)[0]
        assert not told(mr.solve, of_curve(unit * (SLOW + NOISE)), FINE)[0]


def test_on_a_surface():
    box = mr.Box([0, 0], [1, 1])
    x = np.random.default_rng(0).random((2000, 2))
    noise = 0.1 * np.random.default_rng(1).normal(size=len(x))
    problem = lambda y: mr.make_problem(box, LINE, x, y[:, None], centres=48)
    fast = np.sin(60 * x[:, 0]) + noise
    assert told(mr.solve, problem(fast), 1e-9)[0]
    assert not told(mr.solve, problem(x[:, 0] ** 2 + noise), 1e-9)[0]


def test_traced_fits_are_not_judged():
    problem = of_curve(FAST)
    w = jnp.zeros((problem.pattern.size, 1))
    judged = lambda lam: (warn_where_coarse(problem, w, lam), lam)[1]
    assert not told(jax.make_jaxpr(judged), 1e-3)[0]
