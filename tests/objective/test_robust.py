"""Robust losses against scipy's, statsmodels' and the densities they come from; their
efficiency against simulations."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy import integrate, stats
from scipy.optimize._lsq.least_squares import IMPLEMENTED_LOSSES

from manireg._objective.efficiency import efficiency_of, efficient_radius
from manireg._objective.robust import (
    AbstractLoss,
    Huber,
    Squared,
    StudentT,
    Tukey,
    check_loss,
)

LOSSES_OF_SCIPY: Any = IMPLEMENTED_LOSSES
LOSSES = [Squared(), Huber(1.7), Tukey(4.0), StudentT(3.0)]
S = np.concatenate([[0.0, 1e-300, 1e-12], np.geomspace(1e-4, 1e6, 60)])


def derivatives(loss, s):
    """Of orders 0, 1, 2."""
    first = jax.grad(loss.rho)
    along = lambda f: np.asarray(jax.vmap(f)(jnp.asarray(s)))
    return np.stack([along(loss.rho), along(first), along(jax.grad(first))])


@pytest.mark.parametrize(
    ("loss", "name", "scale"),
    [(Squared(), "linear", 1.0), (Huber(1.7), "huber", 1.7**2)]
    + [(StudentT(3.0), "cauchy", 3.0)],
)  # fmt: skip
def test_losses_of_scipy(loss, name, scale):
    """Whose argument is s / scale."""
    expected = np.zeros((3, len(S)))
    if name == "linear":
        expected[:2] = S, np.ones_like(S)
    else:
        LOSSES_OF_SCIPY[name](S / scale, expected, cost_only=False)
    expected *= scale ** np.array([[1.0], [0.0], [-1.0]])
    found = derivatives(loss, S)
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-15)


def test_tukey():
    c, loss = 4.0, Tukey(4.0)
    rest = np.maximum(1 - S / c**2, 0.0)
    found = derivatives(loss, S)
    np.testing.assert_allclose(
        found[0], c**2 / 3 * (1 - rest**3), rtol=1e-10, atol=1e-15
    )
    np.testing.assert_allclose(found[1], rest**2, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(found[2], -2 / c**2 * rest, rtol=1e-12, atol=1e-15)
    small = loss.rho(jnp.asarray(1e-20))
    assert float(small) == 1e-20


@pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: type(loss).__name__)
def test_derivatives(loss):
    """Finite differences on both sides of the radius; finite at, below and above it."""
    rho = lambda s: loss.rho(jnp.asarray(s))  # also of NumPy's
    for s in (0.3, 2.5, 9.0, 30.0):
        check_grads(rho, (s,), order=2, eps=1e-4, rtol=1e-5)
    c = float(getattr(loss, "c", 1.0))
    below, above = np.nextafter(c**2, 0), np.nextafter(c**2, np.inf)
    for s in (0.0, below, c**2, above, 1e300):
        assert np.all(np.isfinite(derivatives(loss, [s])))
    of_residual = lambda r: loss.rho(jnp.sum(r**2))
    origin = jnp.zeros(3)
    np.testing.assert_array_equal(jax.grad(of_residual)(origin), 0)
    np.testing.assert_allclose(jax.hessian(of_residual)(origin), 2 * np.eye(3))
    around = c**2 * (1 + np.array([-1e-9, 1e-9]))
    np.testing.assert_allclose(*derivatives(loss, around)[:2].T, rtol=1e-8, atol=1e-8)


def test_norms_of_statsmodels():
    norms = pytest.importorskip("statsmodels.robust.norms")
    r = np.linspace(-9, 9, 81)
    pairs = [(Huber(1.7), norms.HuberT(1.7)), (Tukey(4.0), norms.TukeyBiweight(4.0))]
    for loss, norm in pairs:
        rho, weight, _ = derivatives(loss, r**2)
        at_zero = norm.rho(np.zeros(1))
        np.testing.assert_allclose(rho, 2 * (norm.rho(r) - at_zero), atol=1e-13)
        np.testing.assert_allclose(weight, norm.weights(r), atol=1e-13)


def test_density_of_t():
    n, nu = 3, 4
    r = np.random.default_rng(0).normal(size=(20, n)) * 3
    density = stats.multivariate_t(np.zeros(n), df=nu)
    expected = -2 * (density.logpdf(r) - density.logpdf(np.zeros(n)))
    rho = StudentT(nu).rho(jnp.sum(r**2, axis=1))
    np.testing.assert_allclose((nu + n) / nu * rho, expected, rtol=1e-12)


def test_numbers_are_leaves():
    radii = jnp.array([1.0, 2.0])
    found = jax.vmap(lambda c: Huber(c).rho(jnp.asarray(9.0)))(radii)
    np.testing.assert_allclose(found, [5.0, 8.0])
    of_radius = lambda c: Tukey(c).rho(jnp.asarray(7.0))
    check_grads(of_radius, (jnp.asarray(3.3),), order=1)
    assert [len(jax.tree.leaves(loss)) for loss in LOSSES] == [0, 1, 1, 1]
    assert [loss.redescending for loss in LOSSES] == [False, False, True, True]


# Radii of equal efficiency


def radius(loss, n):
    return float(np.asarray(loss.in_dimension(n).c))


def test_known_radii():
    assert radius(Huber(), 1) == pytest.approx(1.345, abs=5e-5)
    assert radius(Tukey(), 1) == pytest.approx(4.685, abs=1e-4)
    assert efficient_radius(Huber, 1, 0.9) == pytest.approx(0.98180, abs=5e-5)
    assert efficient_radius(Tukey, 1, 0.85) == pytest.approx(3.4437, abs=5e-5)


def test_in_dimension():
    assert [loss.in_dimension(3) for loss in LOSSES] == LOSSES
    huber = [radius(Huber(), n) for n in range(1, 12)]
    rounded = [1.345, 1.501, 1.628, 1.731, 1.812, 1.869] + 5 * [1.897]
    np.testing.assert_allclose(huber, rounded, atol=5e-4)
    tukey = [radius(Tukey(), n) for n in range(1, 7)]
    np.testing.assert_allclose(
        tukey, [4.685, 5.123, 5.490, 5.810, 6.096, 6.356], atol=5e-4
    )
    for n in (8, 10, 50):
        assert efficiency_of(Huber(huber[6]), huber[6], n) > 0.95
    inside = jax.jit(lambda s: Tukey().in_dimension(2).rho(s))(jnp.asarray(1e9))
    assert inside == pytest.approx(tukey[1] ** 2 / 3)


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_efficiency_of_huber(n):
    """With integrals of the pull and its derivative, without Stein's lemma."""
    c = radius(Huber(), n)
    density = lambda r: stats.chi.pdf(r, n)
    over = lambda f, a, b: integrate.quad(lambda r: f(r) * density(r), a, b)[0]
    derivative = over(lambda r: 1.0, 0, c) + over(lambda r: c / r * (n - 1) / n, c, 40)
    pull = (over(lambda r: r**2, 0, c) + over(lambda r: c**2, c, 40)) / n
    assert derivative**2 / pull == pytest.approx(0.95, abs=1e-8)


@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.parametrize("loss", [Huber(), Tukey()], ids=["Huber", "Tukey"])
def test_simulated_efficiency(loss, n):
    """Locations of 200 Gaussian points, 3,000 times, by reweighting."""
    weight = jax.jit(jax.vmap(jax.vmap(jax.grad(loss.in_dimension(n).rho))))
    points = np.random.default_rng(n).normal(size=(3000, 200, n))
    location = means = points.mean(axis=1)
    for _ in range(12):
        s = np.sum((points - location[:, None]) ** 2, axis=2)
        w = np.asarray(weight(s))[..., None]
        location = np.sum(w * points, axis=1) / np.sum(w, axis=1)
    assert np.mean(means**2) / np.mean(location**2) == pytest.approx(0.95, abs=0.012)


# What is refused


def test_check_loss():
    assert check_loss("squared") == Squared()
    assert all(check_loss(loss) is loss for loss in LOSSES)

    class Mine(AbstractLoss):
        def rho(self, s):
            return jnp.log1p(s)

    mine = Mine()
    assert check_loss(mine) is mine and mine.redescending
    assert mine.in_dimension(2) is mine


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: check_loss("geodesic"), "'geodesic' is a distance; .*='geodesic'"),
        (lambda: check_loss("chord"), "'chord' is a distance; .*='chord'"),
        (lambda: check_loss("huber"), r"'squared', Squared\(\), Huber.*found 'huber'"),
        (lambda: check_loss(None), "expected 'squared', .*found None"),
        (lambda: check_loss(Huber), r"found the class Huber, without its \(\)"),
        (lambda: Huber(0.0), "Huber: c: must be positive and finite, found 0"),
        (lambda: Tukey(np.inf), "Tukey: c: must be positive and finite, found inf"),
        (lambda: StudentT(-2), "StudentT: nu: must be positive and finite, found -2"),
        (lambda: StudentT(None), "StudentT: nu: must be positive .*found nan"),
        (lambda: Huber([1.0, 2.0]), r"Huber: c: expected one number, found shape \(2,\)"),
        (lambda: Tukey("4"), "Tukey: c: expected real numbers"),
        (lambda: Huber().rho(jnp.ones(2)), r"Huber: c depends on the dimension"),
    ],
)  # fmt: skip
def test_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
