"""Fits to data simulated from a fit: how far noise alone moves it."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from .._objective.arguments import of_data
from .._objective.problem import Problem
from .._solver.at_minimum import at_minimum
from .._solver.minimise import minimise, newton_minimiser
from .._solver.model import RegressionMap
from ..manifolds._defaults.frames import orthonormal_axes, tangent_frames
from .sweep import sweep

RTOL = 1e-8  # predicted relative decrease of the last Newton step
MAX_STEPS = 40


def bootstrap(model: RegressionMap, key: PRNGKeyArray, m: int) -> list[RegressionMap]:
    r"""Parametric bootstrap: `m` maps, each fitted with the lambda of `model` to data
    $\exp_{\hat y_i}(\epsilon_i)$, $\epsilon_i$ normal with the covariance of datum i as
    given or found. They scatter like `model.posterior().sampling_covariance` says; regions
    of a posterior are wider and hold the truth more often. Spread over devices by
    `mr.sweep`.

    **Raises** ValueError for a map without its problem, with latent inputs, or with data
    of which nothing is known along some axis.

    **Example:** twenty other paths that the poles might have given.

    ```python
    data = mr.datasets.polar_wander("india")  # 33 poles: ages, unit vectors
    interval, sphere = mr.Interval(0, 320), mr.Sphere(2)
    model = mr.fit(interval, sphere, data.ages, data.directions, 1e3)
    maps = mr.bootstrap(model, jax.random.key(0), 20)
    ```
    """
    found = at_minimum(model)
    problem = model.problem
    assert problem is not None
    if problem.owner is not None:
        raise ValueError("bootstrap: not of maps with latent inputs.")
    noise, target = problem.noise, problem.target
    if noise is not None and np.any(np.asarray(noise.precisions) == 0):
        raise ValueError(
            "bootstrap: some precisions are zero along an axis, where no datum can be "
            "drawn."
        )
    fitted = model(problem.source.from_ambient(problem.x))
    flat = np.asarray(fitted).reshape(len(problem.y), -1)
    frames = tangent_frames(target, flat)
    axes = orthonormal_axes(target, flat, frames)
    normal = jax.random.normal(key, (m, len(flat), target.dim))
    steps = np.einsum("ktn,mkn->mkt", frames, _coloured(problem, axes, normal))
    steps *= np.sqrt(found.spread.variance)
    shape = (m, len(flat), *target.point_shape)
    y = target.project(target.exp(fitted[None], jax.device_put(steps.reshape(shape))))
    y = np.asarray(y).reshape(m, len(flat), -1)
    lanes = np.stack([of_data(each, len(flat)) for each in y])
    shared = found.given, model.lam, model.coefficients, found.solvers
    found = jax.device_put(np.asarray(sweep(_refitted, lanes, shared)))
    alone = dataclasses.replace(model, problem=None)
    return [dataclasses.replace(alone, coefficients=w) for w in found]


def _coloured(problem: Problem, frames, normal) -> Float[np.ndarray, "m k n"]:
    """Of the covariances of the data relative to that of mean precision. Axes at a datum
    are brought to its fitted value by projection."""
    q = np.asarray(problem.precision.relative)
    normal = np.asarray(normal)
    if q.ndim == 1:
        return normal / np.sqrt(q)[:, None]
    factors = np.swapaxes(q @ frames, 1, 2)
    precisions = factors @ np.swapaxes(factors, 1, 2)
    roots = np.linalg.cholesky(np.linalg.inv(precisions))
    return np.einsum("kij,mkj->mki", roots, normal)


def _refitted(y: Float[Array, "k t"], shared: Any) -> Float[Array, "KC t"]:
    problem, lam, w, solvers = shared
    problem = eqx.tree_at(lambda p: p.y, problem, y)
    newton = newton_minimiser(solvers, RTOL, MAX_STEPS)
    return minimise(problem, lam, w, "projected", newton).w
