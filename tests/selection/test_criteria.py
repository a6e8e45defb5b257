"""Criteria of lambda against dense smoothing splines."""

# what is None elsewhere is known here
# pyright: reportOptionalMemberAccess=false, reportArgumentType=false
# pyright: reportOptionalOperand=false, reportCallIssue=false
# pyright: reportAttributeAccessIssue=false

import numpy as np
import pytest
from dense_splines import CENTRES, Spline, bending, noisy_wave
from scipy.optimize import brentq

import manireg as mr
from manireg._selection.criteria import (
    GeneralisedCrossValidation,
    RestrictedLikelihood,
    criterion_of,
)
from manireg._solver.spread import Spread

X, Y, SOURCE = noisy_wave()
K = len(X)
VALUES, VECTORS = np.linalg.eigh(bending(X))
VALUES[:2] = 0.0
Z = VECTORS.T @ Y


@pytest.fixture(scope="module")
def problem():
    return mr.make_problem(SOURCE, mr.Euclidean(1), X, Y[:, None], centres=CENTRES)


def dense(lam):
    """rss, penalty and effective degrees of freedom, in the basis of Demmler and
    Reinsch."""
    a = K * lam * VALUES
    f = Z / (1 + a)
    return np.sum((Z - f) ** 2), np.sum(a * f**2), np.sum(1 / (1 + a))


def determinants(lam):
    a = K * lam * VALUES[2:]
    return np.sum(np.log1p(a)) - np.sum(np.log(a))


def test_reml(problem):
    def slope(log):
        rss, penalty, edf = dense(np.exp(log))
        return (K - 2) * penalty / (rss + penalty) - (edf - 2)

    exact = np.exp(brentq(slope, -20.0, 0.0, xtol=1e-13))
    cv = mr.leave_one_out(problem, criterion="reml", progress=False)
    assert len(cv.lams) > 5
    np.testing.assert_allclose(cv.lam, exact, rtol=2e-6)
    assert cv.lam == cv.lams[np.argmin(cv.criterion)]


def test_reml_with_sigma():
    """Then the total is not profiled."""
    sigma = 0.2

    def slope(log):
        _, penalty, edf = dense(np.exp(log))
        return penalty / sigma**2 - (edf - 2)

    exact = np.exp(brentq(slope, -20.0, 0.0, xtol=1e-13))
    model = mr.fit(
        SOURCE, mr.Euclidean(1), X, Y[:, None],
        sigma=sigma, scatter="none", centres=CENTRES, criterion="reml", progress=False,
    )  # fmt: skip
    np.testing.assert_allclose(model.lam, exact, rtol=2e-6)


def test_integral_of_the_degrees_of_freedom(problem):
    """Stands for the determinants of the restricted likelihood."""
    lams = np.geomspace(1e-7, 1e-3, 33)
    cv = mr.leave_one_out(problem, lams, criterion="reml", progress=False)
    totals = np.array([sum(dense(lam)[:2]) for lam in lams])
    exact = (K - 2) * np.log(totals) + [determinants(lam) for lam in lams]
    found = (K - 2) * np.asarray(cv.criterion)
    np.testing.assert_allclose(found - found[16], exact - exact[16], atol=2e-3)
    spline = [Spline(X, np.ones(K), K * lam).deviance(Y) for lam in lams[[8, 24]]]
    exact = np.array([sum(dense(v)[:2]) + determinants(v) for v in lams[[8, 24]]])
    np.testing.assert_allclose(np.diff(spline), np.diff(exact), rtol=1e-6)


def test_gcv(problem):
    cv = mr.leave_one_out(problem, criterion="gcv", progress=False)

    def gcv(lam):
        rss, _, edf = dense(lam)
        return rss / (1 - edf / K) ** 2

    exact = [gcv(lam) for lam in np.asarray(cv.lams)]
    resolved = np.asarray(cv.lams) > 1e-8  # by the centres, to six digits or five
    assert np.sum(resolved) >= 6
    np.testing.assert_allclose(
        np.asarray(cv.criterion)[resolved], np.asarray(exact)[resolved], rtol=1e-5
    )
    fine = np.geomspace(cv.lams[0], cv.lams[-1], 4000)
    values = np.array([gcv(lam) for lam in fine])
    best = fine[np.argmin(values)]
    assert abs(np.log(cv.lam / best)) < 0.7  # of a grid in factors of 8
    assert gcv(float(cv.lam)) < 1.003 * values.min()


def test_unknown(unchecked):
    with pytest.raises(ValueError, match="criterion: expected 'error', .* found 'aic'"):
        criterion_of("aic")  # type: ignore[arg-type]


def test_lambdas_without_a_fit():
    """Are infinite; those with one are compared as if they were alone."""
    spreads = [Spread(1.0 + i, 0.5, 12.0 - 3 * i, 40, 2, None, None) for i in range(3)]
    lams, errors = [1e-4, 1e-3, 1e-2], np.ones((4, 3))
    for criterion in (RestrictedLikelihood(), GeneralisedCrossValidation()):
        found = criterion.judged(lams, errors, [spreads[0], None, spreads[2]])
        alone = criterion.judged(lams[::2], errors[:, ::2], spreads[::2])
        assert found[0, 1] == np.inf
        np.testing.assert_allclose(found[0, ::2], alone[0])
        untried = criterion.judged(lams, errors, [None, None, None])
        assert np.all(np.isinf(untried))
