"""Terms of one's own: their minimisers, robust losses, and what is refused."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from curves import INTERVAL, TIMES, X, sphere_data
from scipy.interpolate import make_smoothing_spline

import manireg as mr
from manireg._objective.hessian import exact, gauss_newton
from manireg._objective.objective import objective
from manireg._objective.sites import Stage

LINE, SPHERE = mr.Euclidean(1), mr.Sphere(2)
Y = np.cos(5 * X)[:, None] + np.array([[0.0], [0.3], [-2.0], [0.1]] * 2)


class Attraction(mr.AbstractTerm):
    """Of the map to a given one."""

    f: Callable
    strength: float
    name = "attraction"
    place = "quadrature"
    orders = (0,)

    def arguments(self, x, y):
        return jax.vmap(self.f)(x)

    def residual(self, near, jet, args):
        return near.project(jet.value) - args

    def factor(self, lam, gamma):
        return self.strength


class Huber(mr.AbstractTerm):
    """Of distances to y beyond c: c^2 (2 sqrt(s) / c - 1)."""

    c: float
    name = "huber"
    place = "data"
    orders = (0,)

    def arguments(self, x, y):
        return y

    def residual(self, near, jet, args):
        return near.project(jet.value) - args

    def rho(self, s):
        far = jnp.sqrt(jnp.where(s > self.c**2, s, 1.0))
        return jnp.where(s > self.c**2, self.c * (2 * far - self.c), s)


def problem_of(target, y, *terms, weights=None, centres=60):
    return mr.make_problem(
        INTERVAL, target, X, y, centres=centres, terms=terms, weights=weights
    )


def parabola(x):
    return x**2


def test_strong_attraction_gives_the_map():
    """Parabolas have an Eells energy of 4, less in two layers at the ends."""
    problem = problem_of(LINE, Y, Attraction(parabola, 1e9))
    model = mr.solve(problem, 1e-3)
    np.testing.assert_allclose(model(TIMES), TIMES[:, None] ** 2, atol=1e-6)
    assert model.energies.eells == pytest.approx(4, rel=0.01)
    assert model.energies.terms["attraction"] < 1e-13
    assert model.energies.loss == pytest.approx(np.mean((Y[:, 0] - X**2) ** 2), 1e-5)


def test_attraction_by_quadrature():
    """To zero with the strength s: the spline of the data and of many zeros."""
    n, strength = 4000, 0.3
    problem = problem_of(LINE, Y, Attraction(jnp.zeros_like, strength), centres=100)
    zeros = (np.arange(n) + 0.5) / n
    x, y = np.concatenate([X, zeros]), np.append(Y[:, 0], np.zeros(n))
    weights = np.append(np.full(len(X), 1 / len(X)), np.full(n, strength / n))
    order = np.argsort(x)
    spline = make_smoothing_spline(x[order], y[order], weights[order], lam=1e-3)
    found = mr.solve(problem, 1e-3)(TIMES)[:, 0]
    np.testing.assert_allclose(found, spline(TIMES), atol=2e-4)


def test_huber_is_the_weighted_spline():
    """At the minimum of a robust loss the map is that of squares with the weights rho'."""
    huber = Huber(0.5)
    tiny = np.full(len(X), 1.0)
    model = mr.solve(problem_of(LINE, Y, huber, weights=tiny), 1e-3)
    s = jnp.sum((model(X) - Y) ** 2, axis=1)
    weights = jax.vmap(jax.grad(huber.rho))(s)
    assert weights.min() < 0.5 and weights.max() == 1.0
    total = float(jnp.sum(1 + weights))
    again = mr.solve(problem_of(LINE, Y, weights=1 + weights), 1e-3 * len(X) / total)
    np.testing.assert_allclose(model(TIMES), again(TIMES), atol=1e-7)


def test_arguments_are_copied():
    """Those of a user may change afterwards."""
    x, given = np.linspace(0, 1, 1000), np.zeros((1000, 1))

    class Given(mr.AbstractTerm):
        name = "given"
        place = "data"
        orders = (0,)

        def arguments(self, x, y):
            return given

        def residual(self, near, jet, args):
            return jet.value - args

    line = mr.Euclidean(1)
    problem = mr.make_problem(mr.Interval(0, 1), line, x, x[:, None], terms=(Given(),))
    given[:] = 7.0
    assert np.all(np.asarray(problem.terms[0][1]) == 0.0)


@pytest.mark.parametrize("target", [LINE, SPHERE], ids=["line", "sphere"])
def test_hessians(target):
    y = Y if target is LINE else sphere_data()
    to = jnp.zeros(y.shape[1]).at[0].set(0.7)
    terms = Huber(0.5), Attraction(lambda x: to, 2.0)
    problem = problem_of(target, y, *terms, centres=8)
    w = mr.solve(problem, 1e-2, throw=False).coefficients
    w = w + 0.1 * jax.random.normal(jax.random.key(0), w.shape)
    stage = Stage(problem, 1e-2, 0.1, problem.energy)
    dense = jax.jit(jax.hessian(lambda w: objective(w, stage)[0]))(w)
    dense = dense.reshape(w.size, w.size)
    scale = float(jnp.abs(dense).max())
    np.testing.assert_allclose(exact(w, stage).as_matrix(), dense, atol=1e-12 * scale)
    model = gauss_newton(w, stage).as_matrix()
    assert np.linalg.eigvalsh(model)[0] > -1e-12 * scale


def test_every_term_has_a_name():
    model = mr.solve(problem_of(LINE, Y, Huber(1.0)), 1e-3)
    assert {*model.energies.terms} == {"loss", "eells", "off_manifold", "huber"}
    with pytest.raises(ValueError, match="two have the name 'huber'"):
        problem_of(LINE, Y, Huber(1.0), Huber(2.0))


class Lost(Huber):
    place = "nowhere"


class Bent(Huber):
    orders = (0, 2)


@pytest.mark.parametrize(("term", "found"), [(Lost, "nowhere"), (Bent, r"\(0, 2\)")])
def test_terms_that_have_no_site_are_refused(term, found):
    with pytest.raises(ValueError, match=f"terms: huber .*{found}"):
        problem_of(LINE, Y, term(1.0))
