"""What a fitted map says of itself, against dense smoothing splines and formulas."""

import dataclasses
import functools
import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from scipy.interpolate import make_smoothing_spline
from scipy.stats import chi2

import manireg as mr
from manireg._objective.arguments import argument
from manireg._solver.minima import compared
from manireg._solver.minimum import Minimum

K, LAM = 30, 1e-4
INTERVAL = mr.Interval(0.0, 1.0)


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(1)
    x = np.sort(np.append(rng.uniform(size=K - 2), [0.0, 1.0]))
    return x, np.sin(5 * x) + 0.1 * rng.normal(size=K)


@pytest.fixture(scope="module")
def fitted(data):
    x, y = data
    return mr.fit(INTERVAL, mr.Euclidean(1), x, y[:, None], LAM)


@pytest.fixture(scope="module")
def hat(data):
    """From data to fitted values."""
    x, _ = data
    columns = [make_smoothing_spline(x, e, lam=K * LAM)(x) for e in np.eye(K)]
    return np.stack(columns, axis=1)


def test_numbers_are_those_of_a_smoothing_spline(data, fitted, hat):
    _, y = data
    found = fitted.summary()
    r, h, edf = hat @ y - y, np.diag(hat), np.trace(hat)
    sigma = np.sqrt(r @ r / (K - edf))
    assert (found.k, found.n, found.order) == (K, 1, 2)
    assert found.edf == pytest.approx(edf, rel=1e-4)
    assert (found.dof, found.spread.null) == (K, 2)
    assert found.sigma == pytest.approx(sigma, rel=1e-4)
    close = functools.partial(np.testing.assert_allclose, rtol=1e-4, atol=1e-5)
    each = found.each
    np.testing.assert_array_equal(each.data, np.arange(K))
    np.testing.assert_allclose(each.inputs, data[0])
    close(each.leverages, h)
    close(each.residuals, np.abs(r))
    close(each.left_out, np.abs(r) / (1 - h))
    standardised = np.abs(r) / np.sqrt(1 - h) / sigma
    close(each.standardised, standardised, atol=1e-4)
    worst = np.argsort(-standardised)[:5]
    np.testing.assert_array_equal(found.worst.data, worst)
    close(found.worst.leverages, h[worst])
    lengths = np.abs(r) / (1 - h)
    assert found.left_out.rms == pytest.approx(np.sqrt(np.mean(lengths**2)), rel=1e-4)
    assert found.left_out.largest == pytest.approx(lengths.max(), rel=1e-4)
    assert np.mean(lengths <= found.left_out.median + 1e-6) == pytest.approx(
        0.5, abs=0.04
    )
    assert np.mean(lengths <= found.left_out.decile + 1e-6) == pytest.approx(
        0.9, abs=0.04
    )
    assert found.wavelength == pytest.approx(2 * np.pi * LAM**0.25)
    assert found.sigma_given is found.phi is found.tau is found.likelier is None
    assert found.scale is None and np.all(found.weights == 1)


def test_text(fitted):
    text = str(fitted.summary())
    lines = text.splitlines()
    names = [line.split("  ")[0] for line in lines]
    for name in ("data", "lambda", "degrees of freedom", "left out", "convergence"):
        assert name in names
    assert "0.0001 (wavelength 0.628)" in text
    assert "successful, " in text and "note" not in text and "starts" not in text
    title = names.index("worst 5 data")
    table = lines[title + 1 :]
    assert len(table) == 6 and len({len(line) for line in table}) == 1
    worst = fitted.summary().worst
    assert [int(line.split()[0]) for line in table[1:]] == list(worst.data)
    # values start in one column
    start = {len(n) + len(v) - len(v.lstrip()) for n, v in _pairs(lines[: title - 1])}
    assert len(start) == 1
    degrees = fitted.summary().rows(10.0)["sigma, found"]
    assert degrees == f"{10 * fitted.summary().sigma:.3g}°"


def _pairs(lines):
    cut = [line.index("  ") for line in lines]
    return [(line[:i], line[i:]) for line, i in zip(lines, cut, strict=True)]


@pytest.mark.parametrize(
    ("lam", "note"), [(1e3, "nearly a geodesic"), (1e-12, "follows every datum")]
)
def test_notes_of_extreme_lambdas(data, lam, note):
    x, y = data
    model = mr.fit(INTERVAL, mr.Euclidean(1), x, y[:, None], lam, centres=40)
    (found,) = model.summary().notes
    assert note in found and found in str(model.summary())


def test_order_and_weights_of_zero(data):
    """Indices are those of all data, and those of weight 0 are not counted."""
    x, y = data
    weights = np.ones(K)
    weights[[2, 5]] = 0
    backwards = x[::-1], y[::-1, None]
    model = mr.fit(INTERVAL, mr.Euclidean(1), *backwards, LAM, weights=weights)
    found = model.summary()
    assert found.k == K - 2 == len(found.weights) and found.spread.dof == K - 2
    assert not {2, 5} & {*found.each.data}
    np.testing.assert_allclose(found.each.inputs, x[::-1][found.each.data])
    assert model.data_weights.shape == (K,)


@pytest.fixture(scope="module")
def huber(data):
    x, y = data
    y = y + 1.5 * (np.arange(K) == 12)
    options = {"sigma": 0.1, "scatter": "none", "loss": mr.Huber(1.3)}
    model = mr.fit(INTERVAL, mr.Euclidean(1), x, y[:, None], LAM, **options)
    return y, model


def test_weights_of_huber(data, huber):
    y, model = huber
    r = np.abs(np.asarray(model(data[0]))[:, 0] - y)
    expected = np.minimum(1, 1.3 * 0.1 / r)
    np.testing.assert_allclose(model.data_weights, expected, rtol=1e-6)
    found = model.summary()
    assert found.worst.data[0] == 12 and found.worst.weights[0] < 0.15
    np.testing.assert_allclose(found.each.weights, expected, rtol=1e-6)
    assert found.loss == "Huber(c=1.3)" and found.scale == pytest.approx(0.1)
    text = str(found)
    half, tenth = (np.sum(expected < w) for w in (0.5, 0.1))
    assert f"{half} below a half, {tenth} below a tenth" in text
    assert "Huber(c=1.3), scale 0.1" in text


def test_noise_that_was_given(data):
    """chi^2 of 60 coordinates, and data that scatter twice as much as they say."""
    x, y = data
    given = mr.fit(INTERVAL, mr.Euclidean(1), x, y[:, None], LAM, sigma=0.05)
    found = given.summary()
    assert found.phi is not None and found.tau is not None
    plain = mr.fit(INTERVAL, mr.Euclidean(1), x, y[:, None], LAM).summary()
    assert found.phi == pytest.approx(plain.sigma**2 / 0.05**2, rel=1e-6)
    assert found.sigma_given == pytest.approx(np.hypot(0.05, found.tau), rel=1e-6)
    # of equal variances both are the same
    assert found.tau == pytest.approx(np.sqrt(plain.sigma**2 - 0.05**2), rel=1e-2)
    assert found.likelier in ("factor", "additive")
    assert "tau (scatter added)" in str(found) and "likelier" in str(found)


@pytest.mark.parametrize("named", ["sigma", "precision"])
def test_lengths_are_in_the_unit_of_the_target(data, named):
    """Whatever the precisions: of a fit with one they are divided out."""
    x, y = data
    y = np.stack([y, np.cos(4 * x)], axis=1)
    sigma = 0.1 + 0.2 * x
    noise = sigma if named == "sigma" else np.eye(2) / sigma[:, None, None] ** 2
    options = {named: noise, "scatter": "none"}
    model = mr.fit(INTERVAL, mr.Euclidean(2), x, y, LAM, **options)
    r = np.linalg.norm(np.asarray(model(x)) - y, axis=1)
    each = model.summary().each
    np.testing.assert_allclose(each.residuals, r, rtol=1e-6)
    np.testing.assert_allclose(each.left_out, r / (1 - each.leverages), rtol=1e-6)
    assert chi2.sf(np.sum(each.standardised**2), 2 * K) > 1e-3


def test_map_without_its_problem(fitted):
    bare = dataclasses.replace(fitted, problem=None)
    with pytest.raises(ValueError, match="left its problem behind"):
        bare.summary()
    with pytest.raises(ValueError, match="replace"):
        _ = bare.data_weights
    traced = eqx.filter_jit(lambda p: mr.solve(p, LAM))(fitted.problem)
    assert traced.problem is None
    whole = dataclasses.replace(traced, problem=fitted.problem).summary()
    assert whole.minima is None
    assert whole.sigma == pytest.approx(fitted.summary().sigma, rel=1e-6)


def test_few_centres_are_told(data):
    x, y = data
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mr.ResolutionWarning)
        model = mr.fit(INTERVAL, mr.Euclidean(1), x, y[:, None], 1e-9, centres=6)
    found = model.summary()
    assert found.unresolved > K / 2
    assert f"{found.unresolved} inputs lie closer than" in str(found)


def half_turn(apart):
    x = np.array([0.0, 0.0, 1.0, 1.0])
    angle = np.array([0.0, 0.0, apart, apart])
    y = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return mr.make_problem(INTERVAL, mr.Sphere(1), x, y, order=1)


def test_two_ways_round_a_circle():
    """Harmonic curves between two places have the objective lam D^2 / (1 + 4 lam), D the
    way from one to the other."""
    problem = half_turn(np.pi - 0.1)
    mirrored = half_turn(0.1 - np.pi)
    other = mr.solve(eqx.tree_at(lambda p: p.y, problem, mirrored.y), 0.1)
    model = mr.solve(problem, 0.1, warm=other.coefficients)
    assert int(model.stats["num_minima"]) == 2
    gap = ((np.pi + 0.1) / (np.pi - 0.1)) ** 2 - 1
    assert float(model.stats["second_minimum"]) == pytest.approx(gap, rel=1e-2)
    text = str(model.summary())
    assert f"disagree: 2 minima, the second {100 * gap:.2g} % higher" in text
    alone = mr.solve(problem, 0.1)
    assert int(alone.stats["num_minima"]) == 1
    assert "disagree" not in str(alone.summary())


def test_minima_that_hardly_differ(fitted):
    problem = argument(fitted.problem)
    far = fitted.coefficients + 1.0
    failed = optx.RESULTS.nonlinear_max_steps_reached

    def ended(height, w=fitted.coefficients, result=fitted.result):
        return Minimum(w, 0.0, jnp.asarray(height), fitted.energies, result, {}, None)

    def told(*found):
        stats = compared(problem, found)
        return int(stats["num_minima"]), float(stats["second_minimum"])

    assert told(ended(2.0), ended(2.0 + 1e-8)) == (1, np.inf)
    assert told(ended(2.1, far), ended(2.0)) == (2, pytest.approx(0.05))
    assert told(ended(2.0), ended(2.01), ended(2.2)) == (3, pytest.approx(0.005))
    assert told(ended(2.01, far, failed), ended(2.0)) == (1, np.inf)
    assert told(ended(1e-20), ended(5e-20, far)) == (1, np.inf)
    assert told(ended(2.0, result=failed)) == (0, np.inf)
    with pytest.warns(
        mr.SeveralMinimaWarning, match="0.5 % higher, and they are .* apart"
    ):
        assert told(ended(2.01, far), ended(2.0)) == (2, pytest.approx(0.005))


def test_many_data_off_curves_are_drawn(monkeypatch):
    monkeypatch.setattr("manireg._solver.fitted.SCORED", 20)
    x = jax.random.uniform(jax.random.key(0), (30, 2))
    y = np.asarray(x[:, :1] * x[:, 1:])
    model = mr.fit(mr.Box([0, 0], [1, 1]), mr.Euclidean(1), x, y, 1e-4, centres=20)
    found = model.summary()
    assert found.k == 30 and len(found.each.data) == 20
    np.testing.assert_allclose(found.each.inputs, np.asarray(x)[found.each.data])
    assert "[" in found.worst_table()[1][1]
