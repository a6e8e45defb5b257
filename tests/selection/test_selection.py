"""Choice of lambda by cross-validation."""

# pyright: reportArgumentType=false, reportIndexIssue=false

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import manireg as mr
from manireg._selection.choice import evaluated
from manireg._selection.folds import training_sets

INTERVAL, LINE = mr.Interval(0, 1), mr.Euclidean(1)
K = 40
X = np.sort(np.random.default_rng(0).uniform(size=K))
NEW = np.linspace(X[0], X[-1], 200)
NOISE = 0.2 * np.random.default_rng(1).normal(size=K)
truth = lambda x: np.sin(2 * np.pi * x)


def choose(y=truth(X) + NOISE, x=X, lams=None, source=INTERVAL, **options):
    given: dict[str, Any] = dict(folds=4, centres=40, progress=False) | options
    return mr.cross_validate(source, LINE, x[:, None] if source.point_shape else x,
                             y[:, None], lams, **given)  # fmt: skip


@pytest.fixture(scope="module")
def chosen():
    return choose()


@pytest.mark.slow
def test_lambda_beats_both_ends_of_the_grid(chosen):
    problem = mr.make_problem(
        INTERVAL, LINE, X, (truth(X) + NOISE)[:, None], centres=40
    )

    def error(lam):
        return np.sqrt(np.mean((mr.solve(problem, lam)(NEW)[:, 0] - truth(NEW)) ** 2))

    best = np.sqrt(np.mean((chosen.model(NEW)[:, 0] - truth(NEW)) ** 2))
    assert best < 0.5 * error(chosen.lams[0])
    assert best < 0.5 * error(chosen.lams[-1])
    assert best < 0.1
    assert chosen.model.lam == chosen.lam


def test_scores_by_hand(chosen):
    """One fold refitted without the held-out data gives its column of the scores."""
    fold_of = np.asarray(jax.random.permutation(jax.random.key(0), K)) % 4
    assert chosen.scores.shape == (4, len(chosen.lams)) == chosen.converged.shape
    y, lam = (truth(X) + NOISE)[:, None], chosen.lams[12]
    inside = fold_of != 3
    model = mr.fit(INTERVAL, LINE, X[inside], y[inside], lam, centres=40)
    held_out = np.mean(np.abs(model(X[~inside]) - y[~inside]))
    np.testing.assert_allclose(chosen.scores[3, 12], held_out, rtol=1e-4)
    assert chosen.lam == chosen.lams[np.argmin(chosen.scores.mean(0))]
    assert chosen.score == chosen.scores.mean(0).min()
    assert not chosen.on_edge


def test_a_problem_in_place_of_data(chosen):
    y = (truth(X) + NOISE)[:, None]
    problem = mr.make_problem(INTERVAL, LINE, X, y, centres=40)
    result = mr.cross_validate(problem, folds=4, progress=False)
    np.testing.assert_array_equal(result.lams, chosen.lams)
    np.testing.assert_array_equal(result.scores, chosen.scores)
    np.testing.assert_array_equal(result.model.coefficients, chosen.model.coefficients)
    lams = chosen.lams[jnp.array([12, 10, 11])]
    given = mr.cross_validate(problem, lams, folds=4, progress=False)
    np.testing.assert_array_equal(given.lams, chosen.lams[10:13])


def test_fit_without_lambda_chooses_it(chosen):
    y = (truth(X) + NOISE)[:, None]
    model = mr.fit(INTERVAL, LINE, X, y, centres=40, folds=4, progress=False)
    assert model.lam == chosen.lam
    np.testing.assert_array_equal(model.coefficients, chosen.model.coefficients)


def test_reproducible_with_the_key(chosen):
    again = choose(key=jax.random.key(0))
    np.testing.assert_array_equal(again.scores, chosen.scores)
    other = choose(key=jax.random.key(1))
    both = np.isfinite(other.scores) & np.isfinite(chosen.scores)
    assert np.abs(other.scores - chosen.scores)[both].max() > 1e-3


def test_given_lambdas_are_sorted_and_kept(chosen):
    lams = np.geomspace(1e-2, 1e-6, len(chosen.lams))
    result = choose(lams=jnp.asarray(lams))
    np.testing.assert_allclose(result.lams, lams[::-1])
    assert result.lam == result.lams[np.argmin(result.scores.mean(0))]


def test_given_lambdas_are_all_tried(chosen):
    """Hopeless ones, too, which the default grid leaves out."""
    assert not np.all(np.isfinite(chosen.scores))
    result = choose(lams=chosen.lams)
    assert np.all(np.isfinite(result.scores)) and np.all(result.converged)
    tried = np.isfinite(chosen.scores)
    np.testing.assert_allclose(result.scores[tried], chosen.scores[tried], rtol=1e-6)


def test_grid_widens_when_the_best_lies_on_its_edge(chosen):
    """A straight line wants lambda = infinity, a fast wave without noise lambda = 0."""
    assert len(chosen.lams) == 20
    up = choose(2 * X + 0.2 * np.random.default_rng(5).normal(size=K))
    assert len(up.lams) > 20
    assert up.lam > mr.lambda_grid(problem_of(X))[-1]
    down = choose(np.sin(30 * X))
    assert len(down.lams) > 20
    assert down.lam < mr.lambda_grid(problem_of(X))[0]
    assert up.on_edge == (up.lam == up.lams[-1])
    for result in (up, down):
        assert np.all(np.diff(result.lams) > 0)
        assert result.lam == result.lams[np.argmin(result.scores.mean(0))]


def problem_of(x, scale=1.0, output=1.0, m=1):
    if m == 1:
        source, x = mr.Interval(0, scale), scale * x
    else:
        source = mr.Box([0, 0], [scale, scale])
        x = scale * np.stack([x, (7 * x) % 1], axis=1)
    y = output * (truth(X) + NOISE)[:, None]
    return mr.make_problem(source, LINE, x, y, centres=40)


@pytest.mark.parametrize("m", [1, 2])
def test_grid_is_scale_free(m):
    grid = mr.lambda_grid(problem_of(X, m=m))
    longer = mr.lambda_grid(problem_of(X, 10.0, m=m))
    np.testing.assert_allclose(longer, grid * 10.0 ** (4 - m), rtol=1e-9)
    higher = mr.lambda_grid(problem_of(X, output=7.0, m=m))
    np.testing.assert_allclose(higher, grid, rtol=1e-12)


def test_choice_is_scale_free(chosen):
    longer = choose(7 * (truth(X) + NOISE), 10 * X, source=mr.Interval(0, 10))
    np.testing.assert_allclose(longer.lam, 1e3 * chosen.lam, rtol=1e-9)
    np.testing.assert_allclose(longer.scores, 7 * chosen.scores, rtol=1e-5)


def test_weights_are_respected(chosen):
    """Wild values of next to no weight leave scores and choice as they are."""
    wild = np.arange(K) % 10 == 4
    y = truth(X) + NOISE + np.where(wild, 30.0, 0.0)
    result = choose(y, weights=np.where(wild, 1e-9, 1.0))
    assert result.score < 1.5 * chosen.score
    assert choose(y).score > 5 * chosen.score
    clean = np.abs(result.model(NEW)[:, 0] - truth(NEW))
    assert clean.max() < 0.3


def test_folds_of_few_data():
    assert len(training_sets(np.ones(40), None, None)) == 10
    few = training_sets(np.ones(4), None, None)
    np.testing.assert_array_equal(np.sort(np.argmin(few, axis=0)), np.arange(4))
    with pytest.raises(ValueError, match="folds: must lie between 2 and .* data, 4; f"):
        training_sets(np.ones(4), 5, None)


def test_every_fold_has_something_to_score():
    weights = np.where(np.arange(30) % 3 == 0, 1.0, 0.0)
    held_out = ~training_sets(weights, 10, None)
    np.testing.assert_array_equal(held_out @ weights, np.ones(10))
    assert np.all(held_out.sum(axis=0) == 1)
    with pytest.raises(ValueError, match="data of positive weight, 10; found 11"):
        training_sets(weights, 11, None)


def test_no_number_never_wins():
    grid = jnp.array([1.0, 2.0, 3.0])
    scores = jnp.array([[jnp.nan, 2.0, 1.0], [0.0, 2.0, 1.0]])
    assert evaluated(grid, lambda _: (scores,), widen=False)[2] == 2
    with pytest.raises(ValueError, match="no value of the grid has a finite score"):
        evaluated(grid, lambda _: (jnp.nan * scores,), widen=False)


@pytest.mark.parametrize("k", [4, 9])
def test_few_data(k):
    x = np.linspace(0.1, 0.9, k)
    model = mr.fit(INTERVAL, LINE, x, 2 * x[:, None], centres=10, progress=False)
    np.testing.assert_allclose(model(x)[:, 0], 2 * x, atol=1e-6)


@pytest.mark.slow
def test_data_of_weight_zero_are_not_scored():
    wild = np.arange(K) % 10 == 4
    y = (truth(X) + NOISE + np.where(wild, 30.0, 0.0))[:, None]
    lams = [1e-4, 1e-6, 1e-5, 1e-5]
    chosen = []
    for weights, kept in ((1.0 - wild, slice(None)), (None, ~wild)):
        problem = mr.make_problem(
            INTERVAL, LINE, X[kept], y[kept], weights=weights, centres=20
        )
        folds = mr.cross_validate(
            INTERVAL, LINE, X[kept], y[kept], lams, weights=weights, centres=20,
            folds=4, progress=False,
        )  # fmt: skip
        chosen.append((folds, mr.leave_one_out(problem, lams, progress=False)))
        shortest = 1 / 36  # the spacing of those that count
        lowest = mr.lambda_grid(problem)[0]
        np.testing.assert_allclose(lowest, (shortest / (2 * np.pi)) ** 4, rtol=1e-9)
    for with_zeros, without in zip(*chosen):
        np.testing.assert_array_equal(with_zeros.lams, [1e-6, 1e-5, 1e-4])
        np.testing.assert_allclose(with_zeros.scores, without.scores, rtol=1e-6)
        assert with_zeros.lam == without.lam


def test_curve_on_the_sphere():
    circle = lambda x: np.stack([np.cos(4 * x), np.sin(4 * x), 1 + 0 * x], 1) / 2**0.5
    noise = 0.1 * np.random.default_rng(2).normal(size=(K, 3))
    sphere = mr.Sphere(2)
    y = sphere.project(jnp.asarray(circle(X) + noise))
    result = mr.cross_validate(
        INTERVAL, sphere, X, y, folds=4, centres=40, progress=False
    )
    assert np.mean(result.converged) > 0.9
    error = np.sqrt(np.mean(np.sum((result.model(NEW) - circle(NEW)) ** 2, axis=1)))
    assert error < 0.05
    assert result.score == pytest.approx(0.1 * np.sqrt(np.pi / 2), rel=0.3)


def test_sphere_source():
    """Scores are those of fits without the fold."""
    rng = np.random.default_rng(4)
    sphere = mr.Sphere(2)
    x = sphere.project(jnp.asarray(rng.normal(size=(K, 3))))
    y = (x[:, 2] ** 2 + x[:, 0] * x[:, 1])[:, None] + 0.1 * rng.normal(size=(K, 1))
    problem = mr.make_problem(sphere, LINE, x, y, centres=30)
    lams = [1e-4, 1e-6, 1e-2]
    result = mr.cross_validate(problem, lams, folds=3, progress=False)
    assert np.all(result.converged) and result.lam == 1e-4
    assert not result.on_edge
    for fold, inside in enumerate(training_sets(np.ones(K), 3, None)):
        weights = jnp.asarray(inside, float)
        without = eqx.tree_at(lambda p: p.weights, problem, weights)
        off = np.abs(mr.solve(without, 1e-4)(x) - y)[~inside]
        np.testing.assert_allclose(result.scores[fold, 1], off.mean(), rtol=1e-4)
