"""Newton's method with a model of the Hessian."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

from manireg._solver.newton import Direction, Newton

A = jnp.array([[2.0, 0.5], [0.5, 1.0]])
START = jnp.array([3.0, -4.0])


def newton(model, exact, rtol, atol, **options) -> Newton:
    """With dense Hessians, functions of y."""

    def direction(use_exact, y, args, gradient, last):
        hessian = jnp.where(use_exact, exact(y), model(y))
        factor = jnp.linalg.cholesky(hessian)  # not a number if indefinite
        step = -jax.scipy.linalg.cho_solve((factor, True), gradient)
        return Direction(step, jnp.all(jnp.isfinite(step)), ())

    return Newton(rtol=rtol, atol=atol, direction=direction, **options)


def counts(share: float, exact_share: float = 1.0, **options) -> dict:
    """Of y^T A y / 2 when the model takes `share` of its curvature for all, the exact
    Hessian `exact_share`."""
    solver = newton(
        lambda y: share * A, lambda y: exact_share * A, 0.0, 1e-12, **options
    )
    energy = lambda y, args: 0.5 * y @ A @ y
    solution = optx.minimise(energy, solver, START, max_steps=None)
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


def minimum(energy, start, model, exact, **options):
    """Solution of `optx.minimise` with dense Hessians."""
    solver = newton(model, exact, 1e-12, 1e-14, **options)
    return optx.minimise(
        lambda y, args: energy(y), solver, start, max_steps=None, throw=False
    )


def valley(y):
    """Steep across a bent floor, along which it falls slowly."""
    return 1e6 * (y[1] - y[0] ** 2) ** 2 + (y[0] - 1) ** 2


def gauss_newton(y):
    across = jnp.array([-2 * y[0], 1.0])
    return 2e6 * jnp.outer(across, across) + jnp.diag(jnp.array([2.0, 0.0]))


def test_a_bent_valley_is_crossed_in_full_steps():
    start = jnp.array([-1.0, 1.0])
    solve = lambda n: minimum(
        valley, start, gauss_newton, jax.hessian(valley), patience=n
    )
    patient, strict = solve(3), solve(0)
    assert patient.result == optx.RESULTS.successful
    np.testing.assert_allclose(patient.value, 1.0, atol=1e-6)
    assert int(patient.stats["num_trials"]) < 8
    assert int(strict.stats["num_trials"]) > 5 * int(patient.stats["num_trials"])


def test_no_success_on_a_saddle():
    energy = lambda y: (y[0] ** 2 - 1) ** 2 + (y[1] - 2) ** 2
    one = lambda y: jnp.eye(2)
    start = jnp.array([0.0, 1.0])
    solve = lambda certify: minimum(
        energy, start, one, jax.hessian(energy), certify=certify
    )
    assert abs(float(solve(False).value[0])) < 1e-6  # where the model alone decides
    solution = solve(True)
    assert solution.result == optx.RESULTS.successful
    np.testing.assert_allclose(
        jnp.abs(solution.value), jnp.array([1.0, 2.0]), atol=1e-6
    )


def test_where_it_gives_up_the_lowest_point_is_returned():
    """Not one of the steps that were tried on the way."""
    start = jnp.array([-1.0, 1.0])
    wrong = lambda y: jnp.diag(jnp.array([1e-3, 1.0]))
    solution = minimum(valley, start, wrong, wrong, longest=1.0)
    assert valley(solution.value) <= valley(start)
