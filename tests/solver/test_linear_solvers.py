"""Solvers of the Hessian against dense numpy ones."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from curves import curve_problem, sphere_data

import manireg as mr
from manireg._algebra.banded import solve_banded
from manireg._algebra.cholesky import BandCholesky, DenseCholesky, SparseCholesky
from manireg._algebra.sparse import band_order
from manireg._objective.hessian import exact, gauss_newton
from manireg._solver.linear import LeastShift, direct_solvers
from manireg._solver.minimise import gauge, stage_of
from manireg._solver.starts import free_solution


def banded(n: int, reach: int, m: int, shift: float):
    """Random symmetric matrix, its blocks, and right-hand sides."""
    rng = np.random.default_rng(n + 10 * reach + 100 * m)
    whole = rng.normal(size=(n * m, n * m))
    block = np.arange(n * m) // m
    apart = np.abs(block[:, None] - block[None, :])
    whole = np.where(apart <= reach, whole + whole.T, 0.0) + shift * np.eye(n * m)
    by_block = whole.reshape(n, m, n, m).swapaxes(1, 2)
    columns = np.zeros((n, reach + 1, m, m))
    for i in range(n):
        below = by_block[i : i + reach + 1, i]
        columns[i, : len(below)] = below
    return whole, jnp.asarray(columns), jnp.asarray(rng.normal(size=(n, 3, m)))


@pytest.mark.parametrize("n, reach, m", [(1, 0, 2), (7, 1, 2), (9, 3, 4), (3, 5, 3)])
def test_banded_systems(n, reach, m):
    whole, columns, rhs = banded(n, reach, m, 10.0 * (reach + 1) * m)
    x = jax.jit(solve_banded)(columns, rhs)
    flat = lambda a: np.asarray(a).swapaxes(1, 2).reshape(n * m, -1)
    np.testing.assert_allclose(flat(x), np.linalg.solve(whole, flat(rhs)), rtol=1e-10)
    lanes = jax.vmap(solve_banded, (0, None))(jnp.stack([columns, 2 * columns]), rhs)
    np.testing.assert_allclose(lanes, jnp.stack([x, x / 2]), rtol=1e-10)


def test_banded_systems_that_are_indefinite():
    _, columns, rhs = banded(6, 2, 3, 0.0)
    assert not np.any(np.isfinite(solve_banded(columns, rhs)))


def closed_curve():
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    x = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    y = np.stack([np.cos(angle), np.sin(2 * angle), 0 * angle + 0.5], axis=1)
    sphere = mr.Sphere(2)
    return mr.make_problem(mr.Sphere(1), sphere, x, sphere.project(jnp.asarray(y)))


@pytest.mark.parametrize("closed", [pytest.param(False, marks=pytest.mark.slow), True])
def test_all_solvers_agree(closed):
    problem = closed_curve() if closed else curve_problem(mr.Sphere(2), sphere_data())
    assert problem.pattern.band is not None
    assert problem.pattern.band < problem.pattern.centres / 2
    w = eqx.filter_jit(free_solution)(problem, 1e-6, direct_solvers(problem))
    stage = stage_of(problem, 1e-6, gauge(problem), "projected", w)
    rhs = jax.random.normal(jax.random.key(0), w.shape)

    @eqx.filter_jit
    def energy_norms(solver, operator):
        """Of what all but agree on: the gauge is left to the ridge."""
        rhs_in_range = operator.mv(rhs)
        x = solver.compute(solver.init(operator, {}), rhs_in_range, {})[0]
        error = x - rhs
        return jnp.sum(error * operator.mv(error)), jnp.sum(rhs * rhs_in_range)

    model_hessian = eqx.filter_jit(gauss_newton)(w, stage)
    for solver in (BandCholesky(), SparseCholesky(), DenseCholesky()):
        error, size = energy_norms(solver, model_hessian)
        assert error < 1e-9 * size
    exact_hessian = eqx.filter_jit(exact)(w, stage, model_hessian)
    for solver in (LeastShift(BandCholesky()), LeastShift(DenseCholesky())):
        error, size = energy_norms(solver, exact_hessian)
        assert abs(error) < 1e-9 * size


def test_the_order_along_a_curve():
    """However the centres come."""
    shuffled = np.random.default_rng(0).permutation(50)
    line = np.linspace(0, 1, 50)[shuffled, None]
    ordered = line[band_order(line, np.full(50, 2.5 / 49))][:, 0]
    assert np.all(np.diff(ordered) > 0) or np.all(np.diff(ordered) < 0)


def test_curves_need_no_callback():
    """The sparse path of a curve runs wherever XLA does."""
    problem = curve_problem(mr.Sphere(2), sphere_data())
    fit: Any = eqx.filter_jit(
        lambda p: mr.solve(p, 1e-3, linear_algebra="sparse", throw=False).coefficients
    )
    program = fit.lower(problem).as_text()
    assert "callback" not in program
    assert "sparsax" not in program
