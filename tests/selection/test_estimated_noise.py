"""Noise found with the map: against dense linear mixed models, scipy's robust fits, and
fits that know which data are outliers."""

# what is None elsewhere is known here
# pyright: reportOptionalMemberAccess=false, reportArgumentType=false
# pyright: reportOptionalOperand=false, reportCallIssue=false
# pyright: reportAttributeAccessIssue=false

import jax.numpy as jnp
import numpy as np
import pytest
from curves import INTERVAL, TIMES, X as CURVE_X, curve_problem, sphere_data
from dense_splines import Spline, noisy_wave
from scipy import stats
from scipy.optimize import least_squares, minimize_scalar

import manireg as mr
from manireg._selection.noise import renewed
from manireg._solver.at_minimum import at_minimum

X, Y, SOURCE = noisy_wave()
K, LAM, LINE, SPHERE = len(X), 1e-5, mr.Euclidean(1), mr.Sphere(2)
RNG = np.random.default_rng(2)
SIGMA = RNG.uniform(0.05, 0.3, K)
NOISE = 0.02 * RNG.normal(size=len(CURVE_X))


def on_line(y=Y, lam=LAM, x=X, **options):
    return mr.fit(SOURCE, LINE, x, np.asarray(y)[:, None], lam, centres=80, **options)


# Scatter that standard deviations leave out


def test_additive():
    """The restricted likelihood of a linear mixed model, at the strength of the prior that
    was found."""
    model = on_line(sigma=SIGMA)
    problem = model.problem
    for _ in range(20):  # beyond the 1 % that `fit` is content with
        problem = renewed(problem, at_minimum(model), "additive")
        model = mr.solve(problem, LAM, warm=model.coefficients, starts=())
    precision = model.problem.precision

    def deviance(tau):
        q = 1 / (SIGMA**2 + tau**2)
        return Spline(X, q, K * LAM * float(precision.mean)).deviance(Y)

    tau = float(precision.scatter)
    best = minimize_scalar(
        deviance, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-6}
    )
    assert 0.05 < tau < 0.3
    np.testing.assert_allclose(tau, best.x, rtol=1e-3)
    np.testing.assert_allclose(
        precision.mean, np.mean(1 / (SIGMA**2 + tau**2)), rtol=1e-10
    )
    fitted = on_line(sigma=SIGMA).problem.precision
    np.testing.assert_allclose(fitted.scatter, tau, rtol=0.03)


def test_kinds_of_scatter():
    """On variances that are a ninth of the truth."""
    sigma = SIGMA / 3
    with_none = on_line(sigma=sigma, scatter="none")
    with_factor = on_line(sigma=sigma, scatter="factor")
    np.testing.assert_allclose(with_factor(X), with_none(X), atol=1e-10)
    mean = np.mean(sigma**-2)
    dense = Spline(X, sigma**-2.0, K * LAM * mean)
    phi = dense.quadratic(Y)[0] / (K - dense.edf)
    for model, factor in ((with_none, 1.0), (with_factor, phi)):
        precision = model.problem.precision
        np.testing.assert_allclose(precision.phi, phi, rtol=1e-4)
        assert precision.scatter == 0
        np.testing.assert_allclose(precision.mean, mean / factor, rtol=1e-4)
        variance = model.posterior("known").covariance(X)[0][:, 0, 0]
        expected = factor * np.diag(dense.covariance)
        np.testing.assert_allclose(variance, expected, rtol=1e-3)
    summary = with_factor.summary()
    np.testing.assert_allclose(summary.sigma_given, np.sqrt(phi / mean), rtol=1e-4)


def test_data_that_scatter_less_than_they_say():
    precision = on_line(sigma=5 * SIGMA).problem.precision
    assert precision.scatter == 0 and precision.phi < 0.3


def test_equal_deviations():
    """With tau they are what is found without them, however small."""
    model = on_line(sigma=0.02)
    np.testing.assert_allclose(model(X), on_line()(X), atol=1e-10)
    tau = float(model.problem.precision.scatter)
    found = at_minimum(on_line()).spread.found
    np.testing.assert_allclose(np.hypot(tau, 0.02), np.sqrt(found), rtol=1e-4)


# Robust losses, whose scale is found or given


def test_huber_of_a_line():
    """Lambda so large that the map is straight, and linear regression."""
    y = 2 * X - 1 + 0.1 * RNG.normal(size=K)
    y[::10] += 2.0
    loss = mr.Huber()
    model = on_line(y, 1e3, sigma=0.1, scatter="none", loss=loss)
    c = float(loss.in_dimension(1).c)
    A = np.stack([np.ones(K), X], axis=1)
    straight = least_squares(
        lambda b: A @ b - y, np.zeros(2), loss="huber", f_scale=0.1 * c, xtol=1e-14,
        ftol=1e-14, gtol=1e-14,
    )  # fmt: skip
    np.testing.assert_allclose(model(X)[:, 0], A @ straight.x, atol=2e-4)
    r = np.abs(A @ straight.x - y) / 0.1
    np.testing.assert_allclose(model.data_weights, np.minimum(1, c / r), atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("loss", [mr.Huber(), mr.Tukey()], ids=["Huber", "Tukey"])
def test_scale_of_contaminated_data(loss):
    x = np.linspace(X[0], X[-1], 200)
    rng = np.random.default_rng(3)
    y = np.sin(6 * x) + 0.1 * rng.normal(size=200)
    wild = rng.permutation(200)[:20]
    y[wild] += rng.choice([-1, 1], 20) * rng.uniform(1.0, 3.0, 20)
    model = on_line(y, x=x, loss=loss)
    # the median with a tenth of outliers is the 0.56 quantile without: 13 % larger
    median = np.median(np.abs(y - np.sin(6 * x))) / stats.norm.ppf(0.75)
    assert 0.1 < median < 0.125
    assert model.problem.misfit.scale == pytest.approx(median, rel=0.08)
    weights = model.data_weights
    others = np.delete(weights, wild)
    if isinstance(loss, mr.Tukey):
        assert weights[wild].max() < 0.01
    assert weights[wild].max() < 0.25 < 0.6 < others.mean()
    off = np.asarray(model(x))[:, 0] - np.sin(6 * x)
    assert np.sqrt(np.mean(off**2)) < 0.05


def poles(k=60):
    """Along an arc, a tenth of them anywhere."""
    rng = np.random.default_rng(4)
    x = np.sort(rng.uniform(0, 1, k))
    truth = lambda x: np.stack([np.cos(2 * x), np.sin(2 * x), 0.5 * x**2], axis=-1)
    y = truth(x) / np.linalg.norm(truth(x), axis=1, keepdims=True)
    y += 0.08 * rng.normal(size=y.shape)
    wild = np.zeros(k, bool)
    wild[rng.permutation(k)[: k // 10]] = True
    y[wild] = rng.normal(size=(wild.sum(), 3))
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return x, y, wild, lambda x: SPHERE.project(jnp.asarray(truth(x)))


def on_sphere(x, y, lam=1e-4, **options):
    return mr.fit(INTERVAL, SPHERE, x, y, lam, centres=80, **options)


@pytest.mark.parametrize(
    "loss", [mr.Tukey(), pytest.param(mr.StudentT(), marks=pytest.mark.slow)]
)
def test_outliers_on_the_sphere(loss):
    x, y, wild, truth = poles()

    def error(model):
        distance = SPHERE.squared_distance(model(TIMES), truth(TIMES))
        return np.sqrt(np.mean(np.asarray(distance)))

    robust = on_sphere(x, y, loss=loss)
    clean = on_sphere(x, y, weights=1.0 - wild)
    assert error(robust) < 1.25 * error(clean) < 0.5 * error(on_sphere(x, y))
    assert robust.data_weights[wild].max() < 0.3
    assert robust.problem.misfit.scale == pytest.approx(0.08, rel=0.3)


def test_a_sigma_too_small_for_tukey():
    x, y, _, _ = poles()
    with pytest.raises(RuntimeError, match="Tukey rejects all but . of 60 .*`sigma`"):
        on_sphere(x, y, sigma=1e-6, scatter="none", loss=mr.Tukey())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"loss": "chord"}, "'chord' is a distance; take `distance='chord'`"),
        ({"loss": mr.Huber(), "folds": 3, "lam": None}, "folds: .*robust"),
        ({"criterion": "reml", "folds": 3, "lam": None}, "folds: they have an error"),
        ({"folds": 3}, "folds: there is nothing to choose"),
        ({"sigma": 0.1, "scatter": "more"}, "scatter: expected 'additive', .* 'more'"),
    ],
)  # fmt: skip
def test_refused(options, message, unchecked):
    with pytest.raises(ValueError, match=message):
        on_line(**{"lam": 1e-4, **options})


# Precisions


def small_residuals():
    smooth = mr.solve(curve_problem(SPHERE, sphere_data()), 1e-3)
    values = np.asarray(smooth(CURVE_X))
    noise = 1e-3 * RNG.normal(size=values.shape)
    return np.asarray(SPHERE.project(jnp.asarray(values + noise)))


def test_precision_that_is_isotropic_where_it_counts():
    y = small_residuals()
    sigma = RNG.uniform(0.5, 2, len(y))
    P = sigma[:, None, None] ** -2 * np.eye(3) + 7 * y[:, :, None] * y[:, None]
    by_precision = mr.solve(curve_problem(SPHERE, y, precision=P), 1e-7)
    by_sigma = mr.solve(curve_problem(SPHERE, y, sigma=sigma), 1e-7)
    np.testing.assert_allclose(by_precision(TIMES), by_sigma(TIMES), atol=1e-6)


def test_sliding():
    """Of every second datum nothing is known along the track: pushed along it, by a
    lot, they say what they said before."""
    x, across = CURVE_X, np.array([0, 0, 1.0])

    def track(shift):
        along = 1.5 * x + shift
        y = np.stack([np.cos(along), np.sin(along), NOISE], axis=1)
        return y / np.linalg.norm(y, axis=1, keepdims=True)

    second = np.arange(len(x)) % 2 == 1
    shift = np.where(second, 0.3 * RNG.choice([-1, 1], len(x)), 0.0)
    P = np.where(second[:, None, None], np.outer(across, across), np.eye(3))
    fit = lambda shift, **options: mr.solve(
        curve_problem(SPHERE, track(shift), **options), 1e-4
    )
    still, slid = fit(0.0, precision=P), fit(shift, precision=P)
    plain = fit(shift)
    off = lambda model: np.abs(np.asarray(model(TIMES) - still(TIMES))).max()
    assert off(slid) < 2e-3 and off(plain) > 0.1
    assert slid.posterior("known").spread.dof == 2 * len(x) - second.sum()
