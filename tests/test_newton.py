"""Newton's method with a model of the Hessian."""

import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
import pytest

from manireg._newton import Newton

A = jnp.array([[2.0, 0.5], [0.5, 1.0]])
START = jnp.array([3.0, -4.0])


def steps(share: float, longest: float) -> int:
    """Steps on y^T A y / 2 when the model takes `share` of its curvature for all."""

    def model(y, args):
        return lx.MatrixLinearOperator(share * A, lx.positive_semidefinite_tag)

    descent = optx.NewtonDescent(linear_solver=lx.Cholesky())
    newton = Newton(
        rtol=0.0,
        atol=1e-12,
        model_hessian=model,
        exact_hessian=lambda y, args, last: model(y, args),
        model_descent=descent,
        exact_descent=descent,
        near=0.0,
        longest=longest,
    )
    energy = lambda y, args: 0.5 * y @ A @ y
    solution = optx.minimise(energy, newton, START)
    np.testing.assert_allclose(solution.value, 0.0, atol=1e-5)
    return int(solution.stats["num_newton_steps"])


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
