"""Newton's method with a model of the Hessian."""

import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
import pytest

from manireg._newton import Newton

A = jnp.array([[2.0, 0.5], [0.5, 1.0]])
START = jnp.array([3.0, -4.0])


def counts(share: float, exact_share: float = 1.0, **options) -> dict:
    """Of y^T A y / 2 when the model takes `share` of its curvature for all, the exact
    Hessian `exact_share`."""

    def hessian(share):
        return lx.MatrixLinearOperator(share * A, lx.positive_semidefinite_tag)

    descent = optx.NewtonDescent(linear_solver=lx.Cholesky())
    newton = Newton(
        rtol=0.0,
        atol=1e-12,
        model_hessian=lambda y, args: hessian(share),
        exact_hessian=lambda y, args, last: hessian(exact_share),
        model_descent=descent,
        exact_descent=descent,
        **options,
    )
    energy = lambda y, args: 0.5 * y @ A @ y
    solution = optx.minimise(energy, newton, START)
    np.testing.assert_allclose(solution.value, 0.0, atol=1e-5)
    return solution.stats


def steps(share: float, longest: float) -> int:
    return int(counts(share, near=0.0, longest=longest)["num_newton_steps"])


def test_the_right_model_takes_one_step():
    assert steps(1.0, 4.0) == 2  # the second finds nothing left


@pytest.mark.parametrize("share", [1.5, 3.0])
def test_steps_of_a_model_too_curved_are_stretched(share):
    assert steps(share, 4.0) == 3
    assert steps(share, 1.0) > 10


def test_stretched_no_further_than_longest():
    assert 3 < steps(9.0, 4.0) < steps(9.0, 1.0)


def test_a_model_too_flat_is_not_stretched():
    assert steps(0.4, 4.0) == steps(0.4, 1.0)


def test_after_an_exact_step_too_long_the_model_goes_on():
    # a hundred times too long: seven halvings each, if tried at every point
    trials = lambda near: int(counts(3.0, 0.01, near=near, longest=1.0)["num_trials"])
    assert trials(np.inf) < trials(0.0) + 10
