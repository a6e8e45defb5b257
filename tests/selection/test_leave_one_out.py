"""Leave-one-out scores against fits without the datum."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from curves import INTERVAL, X, curve_problem, sphere_data

import manireg as mr
from manireg._solver import fitted
from manireg._solver.at_minimum import at_minimum

K = len(X)
Y = np.stack([np.sin(3 * X), np.cos(2 * X) + X], axis=1)
Y += 0.2 * np.random.default_rng(0).normal(size=Y.shape)
WEIGHTS = np.array([1.0, 0.0, 2.0, 0.5, 1.0, 3.0, 0.0, 1.5])


def refitted_errors(problem, lam):
    """Distance of each datum of positive weight from the fit to all others, with their
    factors kept: the shares of the others stay what they were, so lambda grows by
    1 / (1 - s), s the share of the datum; times the weights relative to their mean."""
    weights, errors = np.asarray(problem.weights), []
    for i in np.flatnonzero(weights):
        without = eqx.tree_at(
            lambda p: p.weights, problem, problem.weights.at[i].set(0.0)
        )
        share = weights[i] / weights.sum()
        model = mr.solve(without, lam / (1 - share))
        off = jnp.linalg.norm(model(problem.x[i][None])[0] - problem.y[i])
        errors.append(off * weights[i] / weights[weights > 0].mean())
    return np.array(errors)


def test_linear_leave_one_out_is_exact():
    problem = curve_problem(mr.Euclidean(2), Y)
    loo = mr.leave_one_out(problem, [1e-4, 1e-2], progress=False)
    assert loo.scores.shape == (K, 2)
    expected = refitted_errors(problem, 1e-2)
    np.testing.assert_allclose(loo.scores[:, 1], expected, rtol=1e-6)
    cut = np.minimum(loo.scores, np.quantile(loo.scores, 0.9, axis=0)[None])
    assert loo.lam == loo.lams[cut.mean(0).argmin()] and loo.on_edge


def test_weights():
    """Those of zero have no score, and the others that of the fit without them."""
    problem = curve_problem(mr.Euclidean(2), Y, weights=WEIGHTS)
    loo = mr.leave_one_out(problem, [1e-4, 1e-2], progress=False)
    assert loo.scores.shape == (K - 2, 2)
    expected = refitted_errors(problem, 1e-2)
    np.testing.assert_allclose(loo.scores[:, 1], expected, rtol=1e-6)


def test_curve_on_the_sphere():
    """To first order in the residuals."""
    smooth = mr.solve(curve_problem(mr.Sphere(2), sphere_data()), 1e-3)(X)
    noise = 0.01 * np.random.default_rng(2).normal(size=smooth.shape)
    y = mr.Sphere(2).project(smooth + noise)
    problem = curve_problem(mr.Sphere(2), y)
    loo = mr.leave_one_out(problem, [1e-5], progress=False)
    expected = refitted_errors(problem, 1e-5)
    np.testing.assert_allclose(loo.scores[:, 0], expected, rtol=0.02)


def test_data_in_place_of_a_problem():
    problem = curve_problem(mr.Euclidean(2), Y, weights=WEIGHTS)
    by_problem = mr.leave_one_out(problem, progress=False)
    by_data = mr.leave_one_out(
        INTERVAL, mr.Euclidean(2), X, Y, weights=WEIGHTS, centres=80, progress=False
    )
    np.testing.assert_array_equal(by_data.scores, by_problem.scores)
    np.testing.assert_array_equal(by_data.lams, by_problem.lams)
    assert by_data.lam == by_problem.lam == by_data.model.lam
    assert len(by_data.lams) >= 5


@pytest.mark.parametrize("choose", [mr.leave_one_out, mr.cross_validate])
def test_a_problem_or_data_but_not_both(choose):
    line = mr.Euclidean(2)
    problem = curve_problem(line, Y)
    with pytest.raises(
        ValueError, match="^x, y: missing; give source, target, x and y"
    ):
        choose(INTERVAL, line)
    with pytest.raises(
        ValueError, match="^target, x, y: a `Problem` has these already"
    ):
        choose(problem, line, X, Y)
    with pytest.raises(ValueError, match="^target: a `Problem` has these"):
        choose(problem, line)
    with pytest.raises(ValueError, match="^weights, centres, graded: a `Problem` has"):
        choose(problem, weights=WEIGHTS, centres=80, graded=True)
    with pytest.raises(ValueError, match="^lams: lambda must be positive and finite"):
        choose(problem, [-1.0], progress=False)


def test_on_surfaces_some_data_stand_for_many(monkeypatch):
    """Their scores are what they are among all, each that of the fit without it."""
    x = np.random.default_rng(3).random((90, 2))
    y = np.sin(3 * x) + 0.2 * np.random.default_rng(4).normal(size=x.shape)
    weights = 1.0 + (np.arange(90) % 3)
    weights[::10] = 0.0
    box, plane = mr.Box([0, 0], [1, 1]), mr.Euclidean(2)
    problem = mr.make_problem(box, plane, x, y, weights=weights, centres=20)
    lams = [1e-5, 1e-3]
    every = mr.leave_one_out(problem, lams, progress=False).scores
    np.testing.assert_allclose(every[:, 0], refitted_errors(problem, 1e-5), rtol=1e-5)
    monkeypatch.setattr(fitted, "SCORED", 30)
    some = np.asarray(mr.leave_one_out(problem, lams, progress=False).scores)
    assert some.shape == (30, 2)
    where = np.argmin(abs(some[:, :1] - every[:, 0]), axis=1)
    assert len(np.unique(where)) == 30
    np.testing.assert_allclose(some, every[where], rtol=1e-9)


def test_leverages_beside_a_gap():
    """Many data in two clusters: those that are treated together then lie on both sides of
    the gap. On a line h_ii is the value at x_i of the fit to the i-th unit vector."""
    rng = np.random.default_rng(0)
    left, right = rng.uniform(0, 0.15, 405), rng.uniform(0.8, 1, 400)
    x = np.sort(np.concatenate([left, right]))
    lam, problem = (
        1e-4,
        mr.make_problem(INTERVAL, mr.Euclidean(1), x, 0 * x[:, None], centres=40),
    )
    found = at_minimum(mr.solve(problem, lam)).leverages.leverages[:, 0]
    assert np.sum(found) > 3
    gap = int(np.argmax(np.diff(x)))
    for i in (gap - 1, gap, gap + 1, gap + 2):
        unit = jnp.zeros((len(x), 1)).at[i].set(1.0)
        model = mr.solve(eqx.tree_at(lambda p: p.y, problem, unit), lam)
        assert found[i] == pytest.approx(float(model(x[i])[0]), rel=1e-6)
