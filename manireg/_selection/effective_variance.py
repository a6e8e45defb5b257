r"""Inputs known within errors, by their effect on the outputs: along the velocity v of
the map a datum varies by $|v|\, \sigma_x$ more. Regions then are as wide as they should
be; the map stays flattened by $f'' \sigma_x^2 / 2$, which only `latent_inputs` mends."""

import dataclasses
import warnings

import jax
import numpy as np
from jaxtyping import Float

from .._objective.noise import misfit_of, precision_of
from .._objective.problem import Problem
from .._solver.at_minimum import at_minimum
from .._solver.model import RegressionMap
from .._sources.input_errors import InputErrors
from .._sources.noise import Noise
from ..manifolds._defaults.frames import orthonormal_axes, tangent_frames
from .noise import Again, Scatter, renewed, scaled

ROUNDS = 10
SETTLED = 0.02  # relative change of a precision that is not worth another fit
EXACT = 1e-2  # of the noise found: to which outputs without `sigma` count as exact


def with_effective_variance(
    model: RegressionMap,
    errors: InputErrors,
    again: Again,
    scatter: Scatter,
) -> RegressionMap:
    r"""`model`, fitted as if inputs were exact, fitted anew with the covariances
    $\Sigma_i + v_i v_i^\top \sigma_{x,i}^2$, $v_i$ the velocity of the fit before, brought
    to $T_{y_i}N$ by projection; $\Sigma_i$ what `sigma` or `precision` say, or, where they
    say nothing, a scatter that is estimated.

    **Warns** where that has not settled in 10 rounds."""
    first = model.problem
    assert first is not None
    heavy, tau = np.asarray(first.weights) > 0, float(first.precision.scatter)
    given = first.noise
    if given is None:
        tau, scatter = float(np.sqrt(at_minimum(model).spread.variance)), "additive"
        exact = np.full(len(first.y), (EXACT * tau) ** -2.0)
        given = Noise(jax.device_put(exact), None)
    before = None
    for _ in range(ROUNDS):
        noise = _widened(first, given, model, errors)
        precision = precision_of(noise, heavy, tau)
        misfit = misfit_of(precision, first.misfit.loss)
        changes = {"noise": noise, "precision": precision, "misfit": misfit}
        model = again(dataclasses.replace(first, **changes), model)
        assert model.problem is not None
        found = renewed(model.problem, at_minimum(model), scatter).precision
        tau = float(found.scatter)
        level = np.asarray(found.level) * np.asarray(found.mean)
        if before is not None and np.allclose(level, before, rtol=SETTLED):
            break
        before = level
    else:
        warnings.warn(
            f"fit: the effective variances have not settled in {ROUNDS} rounds; "
            '`x_error="latent"` may.',
            stacklevel=3,
        )
    if scatter != "factor":
        return model
    assert model.problem is not None
    # of errors in y and in x alike
    problem = scaled(model.problem, at_minimum(model))
    return dataclasses.replace(model, problem=problem)


def _widened(
    problem: Problem, noise: Noise, model: RegressionMap, errors: InputErrors
) -> Noise:
    """With the variance along the velocity: of precisions, P - P v v^T P / (1 / s^2 +
    v^T P v)."""
    target, y = problem.target, np.asarray(problem.y)
    frames = orthonormal_axes(target, y, tangent_frames(target, y))
    velocity = np.asarray(model.velocity(problem.source.from_ambient(problem.x)))
    velocity = velocity.reshape(len(frames), -1, 1)
    v = np.einsum("ktn,kto->kn", frames, orthonormal_axes(target, y, velocity))
    P = _in_frames(noise, frames)
    Pv = np.einsum("kij,kj->ki", P, v)
    variance = errors.deviation**2
    share = variance / (1 + variance * np.sum(v * Pv, axis=1))
    values, vectors = np.linalg.eigh(
        P - share[:, None, None] * Pv[:, :, None] * Pv[:, None]
    )
    return Noise(
        jax.device_put(np.maximum(values, 0.0)), jax.device_put(frames @ vectors)
    )


def _in_frames(
    noise: Noise, frames: Float[np.ndarray, "k t n"]
) -> Float[np.ndarray, "k n n"]:
    values = np.asarray(noise.precisions)
    if noise.axes is None:
        return values[:, None, None] * np.eye(frames.shape[2])
    axes = np.swapaxes(frames, 1, 2) @ np.asarray(noise.axes)
    return np.einsum("kin,kn,kjn->kij", axes, values, axes)
