"""Conjugate gradients and shifts for exact Hessians, on random matrices against numpy."""

import equinox as eqx
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest
import scipy.linalg
from jaxtyping import Array, Float

from manireg._algebra.cholesky import DenseCholesky
from manireg._algebra.sparse import SparseSymmetric, SparsityPattern
from manireg._solver.linear import SHIFTS, LeastShift, ModelCG

CENTRES, FUNCTIONS, T = 6, 2, 3
SIZE = CENTRES * FUNCTIONS * T
ROWS, COLS = np.triu_indices(CENTRES)
PATTERN = SparsityPattern(
    jnp.asarray(ROWS), jnp.asarray(COLS), CENTRES, FUNCTIONS, band=None
)


def sparse(matrix) -> SparseSymmetric:
    b = FUNCTIONS * T
    blocks = matrix.reshape(CENTRES, b, CENTRES, b).swapaxes(1, 2)[ROWS, COLS]
    return SparseSymmetric(jnp.asarray(blocks), PATTERN)


class Exact(eqx.Module):
    """What the solvers need of an exact Hessian."""

    matrix: Float[Array, "n n"]
    model: SparseSymmetric

    def mv(self, vector):
        return (self.matrix @ vector.ravel()).reshape(vector.shape)

    def assembled(self):
        return sparse(self.matrix)


RNG = np.random.default_rng(0)
ROOT = RNG.normal(size=(SIZE, SIZE))
MODEL = ROOT @ ROOT.T + np.eye(SIZE)
RHS = jnp.asarray(RNG.normal(size=(CENTRES * FUNCTIONS, T)))


def hessian(curvatures) -> Exact:
    """That has these curvatures, in units of the model's."""
    root = np.linalg.cholesky(MODEL)
    axes = root @ np.linalg.qr(ROOT + ROOT.T)[0]
    return Exact(jnp.asarray(axes * curvatures @ axes.T), sparse(MODEL))


def solve(solver, operator, rhs=RHS):
    run = eqx.filter_jit(lambda o, b: solver.compute(solver.init(o, {}), b, {})[:2])
    x, result = run(operator, rhs)
    return np.asarray(x).ravel(), result


def dense(matrix, rhs=RHS):
    return np.linalg.solve(matrix, np.asarray(rhs).ravel())


@pytest.mark.parametrize("spread", [1.0, 1.1, 30.0])
def test_conjugate_gradients(spread):
    operator = hessian(np.geomspace(1, spread, SIZE))
    x, result = solve(ModelCG(), operator)
    assert result == lx.RESULTS.successful
    error = x - dense(operator.matrix)
    norm = lambda v: np.sqrt(v @ MODEL @ v)
    assert norm(error) < 1e-7 * norm(x)


def test_steps_are_bounded():
    operator = hessian(np.geomspace(1, 30, SIZE))
    few, _ = solve(ModelCG(max_steps=3), operator)
    exact = dense(operator.matrix)
    values = [
        0.5 * x @ operator.matrix @ x - x @ np.asarray(RHS).ravel()
        for x in (few, exact, few + 1e-3 * (exact - few))
    ]
    assert values[1] < values[2] < values[0] < 0


def test_flat_directions_are_left_alone():
    """No curvature but rounding, to either side: not called singular."""
    curvatures = np.ones(SIZE)
    curvatures[:3] = [0.0, 1e-10, -1e-10]
    operator = hessian(curvatures)
    x, result = solve(ModelCG(), operator)
    assert result == lx.RESULTS.successful
    # two different curvatures: minimised along the first direction, then no further
    assert x @ np.asarray(RHS).ravel() > 0
    assert x @ MODEL @ x < 10 * dense(MODEL) @ np.asarray(RHS).ravel()


@pytest.mark.parametrize("negative", [1, 4, SIZE])
def test_of_an_indefinite_operator_the_way_is_downhill(negative):
    curvatures = np.where(np.arange(SIZE) < negative, -0.5, np.linspace(1, 2, SIZE))
    x, result = solve(ModelCG(), hessian(curvatures))
    assert result == lx.RESULTS.singular
    assert np.all(np.isfinite(x)) and x @ np.asarray(RHS).ravel() > 0


def test_where_the_first_direction_bends_down_it_is_that_of_the_model():
    x, _ = solve(ModelCG(), hessian(np.full(SIZE, -2.0)))
    np.testing.assert_allclose(x, dense(MODEL), rtol=1e-8)


def test_negative_curvature_that_the_right_side_does_not_see():
    """Krylov spaces stay where they start."""
    curvatures = np.append(-1.0, np.linspace(1, 2, SIZE - 1))
    operator = hessian(curvatures)
    there = dense(operator.matrix)
    axis = scipy.linalg.eigh(operator.matrix, MODEL)[1][:, 0]
    there = there - axis * (axis @ MODEL @ there)
    rhs = jnp.asarray((operator.matrix @ there).reshape(RHS.shape))
    x, result = solve(ModelCG(), operator, rhs)
    assert result == lx.RESULTS.successful
    np.testing.assert_allclose(x, there, atol=1e-6 * np.abs(there).max())


@pytest.mark.parametrize("shift", SHIFTS)
def test_the_least_shift_that_makes_it_definite(shift):
    """A curvature between the last shift and this one."""
    least = {0.0: 0.5, 0.1: -0.05, 1.0: -0.5, 10.0: -5.0}[shift]
    operator = hessian(np.append(least, np.linspace(1, 2, SIZE - 1)))
    x, result = solve(LeastShift(DenseCholesky()), operator)
    expected = dense(operator.matrix + shift * MODEL)
    np.testing.assert_allclose(x, expected, atol=1e-8 * np.abs(expected).max())
    assert (result == lx.RESULTS.successful) == (shift == 0)
    assert x @ np.asarray(RHS).ravel() > 0


def test_without_shifts_an_indefinite_operator_is_no_number():
    operator = hessian(np.append(-0.05, np.ones(SIZE - 1)))
    x, _ = solve(LeastShift(DenseCholesky(), (0.0,)), operator)
    assert np.all(np.isnan(x))
