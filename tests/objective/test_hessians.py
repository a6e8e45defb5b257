"""Hessians of surfaces against `jax.hessian` of the objective: projected energies of two
dimensions, and patches of a point cloud held fixed."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from clouds import sphere_cloud

import manireg as mr
from manireg._objective.hessian import exact, gauss_newton
from manireg._objective.objective import objective
from manireg._solver.minimise import gauge, stage_of

LAM = 1e-2


def problem_onto(target):
    """Of values on a cap, so that their mean, where w = 0 is, lies near the target."""
    x = np.random.default_rng(0).uniform(size=(30, 2))
    y = np.concatenate([0.8 * (x - 0.5), np.ones((30, 1))], axis=1)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    y = target.project(jnp.asarray(y))
    return mr.make_problem(mr.Box([0, 0], [1, 1]), target, x, y, centres=9)


@pytest.mark.parametrize("patches", [False, True])
def test_exact_hessian_of_a_surface(patches):
    target = sphere_cloud(500) if patches else mr.Sphere(2)
    problem = problem_onto(target)
    shape = (problem.pattern.size, problem.y.shape[1])
    w = 0.05 * jax.random.normal(jax.random.key(0), shape)
    v = jax.random.normal(jax.random.key(1), shape)

    @eqx.filter_jit
    def both(problem, w, v):
        stage = stage_of(problem, LAM, gauge(problem), "projected", w)
        hessian = exact(w, stage)
        value = lambda w: objective(w, stage)[0]
        model = gauss_newton(w, stage).as_matrix()
        return hessian.as_matrix(), hessian.mv(v), jax.hessian(value)(w), model

    assembled, product, expected, model = map(np.asarray, both(problem, w, v))
    expected = expected.reshape(w.size, w.size)
    size = np.abs(expected).max()
    np.testing.assert_allclose(assembled, expected, atol=1e-10 * size)
    along = expected @ np.asarray(v).ravel()
    np.testing.assert_allclose(product.ravel(), along, atol=1e-10 * np.abs(along).max())
    # away from a minimum the model is another matrix, and has no negative curvature
    assert np.abs(model - expected).max() > 1e-3 * size
    assert np.linalg.eigvalsh(model)[0] > -1e-10 * size
