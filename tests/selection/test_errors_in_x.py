"""Inputs known within errors: known results for straight lines, finite differences of the
marginal likelihood, simulations."""

# what is None elsewhere is known here
# pyright: reportOptionalMemberAccess=false, reportArgumentType=false
# pyright: reportOptionalOperand=false, reportCallIssue=false
# pyright: reportAttributeAccessIssue=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from dense_splines import noisy_wave

import manireg as mr
from manireg._selection.latent_inputs import _nodes
from manireg._solver.at_minimum import at_minimum
from manireg._solver.jet_covariances import jets_at
from manireg._sources.input_errors import check_input_errors

X, Y, SOURCE = noisy_wave()
K, LINE, INTERVAL, SPHERE = len(X), mr.Euclidean(1), mr.Interval(0, 1), mr.Sphere(2)


def on_line(y=Y, lam=1e-5, **options):
    y = np.asarray(y)[:, None]
    return mr.fit(SOURCE, LINE, X, y, lam, centres=32, **options)


def test_check_input_errors():
    column = X[:, None]
    assert check_input_errors(SOURCE, column, None, None, None) is None
    normal = check_input_errors(SOURCE, column, 0.1, None, None)
    assert normal is not None and normal.lower is None
    np.testing.assert_array_equal(normal.deviation, np.full(K, 0.1))
    uniform = check_input_errors(SOURCE, column, None, X - 0.1, X + 0.2)
    assert uniform is not None
    np.testing.assert_allclose(uniform.deviation, 0.3 / np.sqrt(12))
    np.testing.assert_array_equal(uniform.lower, X - 0.1)
    np.testing.assert_array_equal(uniform.upper, X + 0.2)


def test_some_normal_and_some_uniform():
    normal = np.arange(K) % 2 == 0
    sigma = np.where(normal, 0.1, np.nan)
    low, high = (np.where(normal, np.nan, X + d) for d in (-0.1, 0.2))
    mixed = check_input_errors(SOURCE, X[:, None], sigma, low, high)
    expected = np.where(normal, 0.1, 0.3 / np.sqrt(12))
    np.testing.assert_allclose(mixed.deviation, expected)
    np.testing.assert_array_equal(np.isnan(mixed.lower), normal)
    # each has the nodes and shares that it has among its own kind
    problem = mr.make_problem(SOURCE, LINE, X, Y[:, None], centres=32)
    model = mr.solve(problem, 1e-5)
    alike = (
        check_input_errors(SOURCE, X[:, None], 0.1, None, None),
        check_input_errors(SOURCE, X[:, None], None, X - 0.1, X + 0.2),
    )
    found = _nodes(problem, model, mixed, 0.1)
    for own, kind in zip(alike, (normal, ~normal), strict=True):
        places, owner, prior = _nodes(problem, model, own, 0.1)
        here, there = kind[owner], kind[found[1]]
        np.testing.assert_array_equal(found[0][there], places[here])
        np.testing.assert_allclose(found[2][there], prior[here])
    both = np.where(normal, 0.1, np.nan)
    both[1] = 0.1
    with pytest.raises(ValueError, match="say no distribution. First at index 1"):
        check_input_errors(SOURCE, X[:, None], both, low, high)


def changed(index, value):
    array = np.full(K, 0.1)
    array[index] = value
    return array


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"x_min": X}, "x_sigma, x_min, x_max: give standard deviations, or both ends"),
        ({"x_max": X}, "a single x_min or x_max"),
        ({"x_sigma": 0.1, "x_min": X, "x_max": X}, "or both kinds, say no"),
        ({"x_sigma": 0.1, "x_max": X}, "x_sigma, x_min, x_max: give"),
        ({"x_sigma": np.ones(3)}, r"x_sigma: expected one .* shape \(40,\).*\(3,\)"),
        ({"x_sigma": changed(2, -1.0)}, "x_sigma: must not be negative; 1 of 40 .*-1 at in"
            "dex 2"),
        ({"x_sigma": changed([3, 5], np.nan)}, "x_sigma: must be finite; 2 of 40 .* 3"),
        ({"x_min": X + 0.2, "x_max": X}, "x_min: must not be above x_max; 40 of 40"),
        ({"x_min": X + 0.1, "x_max": X + 0.2}, "x: must lie between x_min and x_max"),
        ({"x_min": X - 0.1, "x_max": np.ones((K, 1))}, "x_max: expected one number or"),
        ({"x_sigma": 0.1, "x_error": "exact"}, "x_error: expected 'latent' or 'eff"),
    ],
)  # fmt: skip
def test_refused(given, message, unchecked):
    with pytest.raises(ValueError, match=message):
        on_line(**given)


def test_only_numbers_on_an_interval():
    x = np.linspace(0.1, 0.9, K)
    for source, inputs in (
        (mr.Box([0, 0], [1, 1]), np.stack([x, x**2], axis=1)),
        (mr.Circle(), x),
        (mr.Sphere(1), np.stack([np.cos(x), np.sin(x)], axis=1)),
    ):
        found = type(source).__name__
        with pytest.raises(ValueError, match=f"on an `Interval`; found {found}"):
            mr.fit(source, LINE, inputs, Y[:, None], 1e-3, x_sigma=0.1)


def test_errors_of_zero():
    exact = on_line()
    latent = on_line(x_sigma=0.0, progress=False)
    np.testing.assert_allclose(latent(X), exact(X), atol=1e-8)
    effective = on_line(x_sigma=0.0, x_error="effective")
    np.testing.assert_allclose(effective(X), exact(X), atol=1e-8)


def test_effective_variance_of_a_line():
    """Weights of weighted Deming regression, 1 / (sigma^2 + b^2 s^2)."""
    rng = np.random.default_rng(0)
    s, sigma = rng.uniform(0.02, 0.2, K), rng.uniform(0.05, 0.2, K)
    y = 3 * X + sigma * rng.normal(size=K)
    model = on_line(y, 1e3, sigma=sigma, scatter="none", x_sigma=s, x_error="effective")
    b = float(model.velocity(X[5])[0])
    assert 2 < b < 4
    expected = 1 / (sigma**2 + b**2 * s**2)
    precision = model.problem.precision
    found = np.asarray(precision.level) * float(precision.mean)
    np.testing.assert_allclose(found, expected, rtol=0.02)
    A = np.stack([np.ones(K), X], axis=1)
    line = np.linalg.solve(A.T * expected @ A, A.T @ (expected * y))
    np.testing.assert_allclose(model(X)[:, 0], A @ line, atol=2e-3)


def test_latent_inputs_stay_in_their_ranges():
    low, high = np.maximum(X - 0.03, X[0]), np.minimum(X + 0.06, X[-1])
    model = on_line(x_min=low, x_max=high, sigma=0.2, scatter="none", progress=False)
    problem = model.problem
    at, owner = np.asarray(problem.x)[:, 0], problem.owner
    assert len(at) > K and np.all(np.unique(owner) == np.arange(K))
    assert np.all((low[owner] <= at) & (at <= high[owner]))
    total = np.bincount(owner, np.asarray(problem.weights))
    np.testing.assert_allclose(total, 1.0)
    inputs = model.summary().each.inputs
    assert np.all((low <= inputs) & (inputs <= high))
    post = model.posterior()
    assert np.all(post.covariance(X)[0][:, 0, 0] > 0)
    for refused in (
        post.sampling_covariance,
        lambda _: mr.bootstrap(model, jax.random.key(0), 1),
    ):
        with pytest.raises(ValueError, match="not of maps with latent inputs"):
            refused(X)


def test_observed_information():
    """Minus the second derivatives of the logarithm of the marginal likelihood, along
    some directions."""
    sigma = 0.2
    model = on_line(x_sigma=0.05, sigma=sigma, scatter="none", progress=False)
    problem = model.problem
    post = model.posterior("known")
    w = np.asarray(model.coefficients)[:, 0]
    owner, y = problem.owner, np.asarray(problem.y)[:, 0]
    rows = jets_at(model, np.asarray(problem.x), 0).as_matrix(len(w))
    # what EM ended with are posterior shares; the prior ones are those of the places
    at, given = np.asarray(problem.x)[:, 0], X[owner]
    prior = np.exp(-0.5 * ((at - given) / 0.05) ** 2)
    prior /= np.bincount(owner, prior)[owner]
    origin = float(problem.origin[0])

    def minus_log_likelihood(w):
        r = y - origin - rows @ w
        likely = np.bincount(owner, prior * np.exp(-0.5 * (r / sigma) ** 2))
        return -np.sum(np.log(likely))

    shares = np.asarray(problem.weights)
    r = y - origin - rows @ w
    by_hand = prior * np.exp(-0.5 * (r / sigma) ** 2)
    by_hand /= np.bincount(owner, by_hand)[owner]
    np.testing.assert_allclose(shares, by_hand, atol=1e-2)

    # the prior's part of the Hessian: the whole less that of the complete data
    whole = np.asarray(at_minimum(model).hessian.as_matrix())
    complete = (rows.T @ (rows.multiply(shares[:, None]))).toarray() / sigma**2
    prior_part = whole / post.scale - complete
    (only,) = post.mixture.parts
    L = np.tril(only.information.factor)
    information = L @ L.T / post.scale
    rng, basis = np.random.default_rng(0), model.basis
    centres = np.asarray(basis.centres)[:, 0]
    centres = np.repeat(centres, len(w) // len(centres))
    for _ in range(4):
        near = np.exp(-(((centres - rng.uniform(0.1, 0.9)) / 0.1) ** 2))
        v = rng.normal(size=len(w)) * near
        v /= np.linalg.norm(rows @ v) / np.sqrt(len(y))
        h = 1e-3
        f = [minus_log_likelihood(w + s * h * v) for s in (-1, 0, 1)]
        expected = (f[0] - 2 * f[1] + f[2]) / h**2 + v @ prior_part @ v
        np.testing.assert_allclose(v @ information @ v, expected, rtol=0.01)


@pytest.mark.slow
def test_latent_inputs_take_the_bias_off():
    """A wavy path, ages uncertain by a fifth of its wavelength."""
    wave = 0.5

    def truth(x):
        up, along = 0.6 * np.sin(2 * np.pi * x / wave), 2 * x
        level = [np.cos(up) * np.cos(along), np.cos(up) * np.sin(along), np.sin(up)]
        return jnp.asarray(np.stack(level, axis=-1))

    grid, found = np.linspace(0, 1, 101), {"naive": [], "latent": []}
    for seed in range(4):
        rng = np.random.default_rng([11, seed])
        true = rng.uniform(0, 1, 120)
        x = true + wave / 5 * rng.normal(size=120)
        p = truth(true)
        v = SPHERE.tangent_projection(p, jnp.asarray(0.1 * rng.normal(size=p.shape)))
        y = np.asarray(SPHERE.exp(p, v))
        inside = (x > 0) & (x < 1)
        for kind, values in found.items():
            options = {"x_sigma": wave / 5} if kind == "latent" else {}
            model = mr.fit(
                INTERVAL, SPHERE, x[inside], y[inside], criterion="reml",
                progress=False, **options,
            )  # fmt: skip
            values.append(np.asarray(model(grid)))
    bias = {}
    for kind, values in found.items():
        mean = SPHERE.project(jnp.mean(jnp.asarray(values), axis=0))
        gap = np.sqrt(np.asarray(SPHERE.squared_distance(mean, truth(grid))))
        bias[kind] = gap.mean()
    assert bias["latent"] < 0.5 * bias["naive"]
