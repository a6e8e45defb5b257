"""Noise estimated with the map: the scatter that given standard deviations leave out, and
the scale of a robust loss, each renewed between fits until it stays."""

import dataclasses
import warnings
from collections.abc import Callable
from typing import Literal

import equinox as eqx
import numpy as np
from scipy.optimize import root_scalar
from scipy.stats import chi2

from .._input.precision import as_scalar
from .._objective.noise import Precision, misfit_of, precision_of
from .._objective.problem import Problem
from .._objective.terms import weight_of
from .._programs.sizes import at_each
from .._solver.at_minimum import AtMinimum, at_minimum
from .._solver.model import RegressionMap
from .._sources.orders import least_inputs

Scatter = Literal["additive", "factor", "none"]
Again = Callable[[Problem, RegressionMap], RegressionMap]  # a fit near a map
ROUNDS = 12
SETTLED = 3e-3  # relative change of a standard deviation that is not worth another fit
BLUNT = 1e4  # scale of a robust loss, in root mean squares of the data, that is squared
KEPT = 0.1  # of its weight, by a datum that is not rejected


def check_scatter(scatter: str) -> None:
    if scatter not in ("additive", "factor", "none"):
        raise ValueError(
            f"scatter: expected 'additive', 'factor' or 'none', found {scatter!r}."
        )


def blunted(problem: Problem) -> Problem:
    """The same with a robust loss so wide that it is the squared one: a start for it."""
    if problem.misfit.squared:
        return problem
    size = np.sqrt(np.mean(np.sum(np.asarray(problem.y - problem.origin) ** 2, axis=1)))
    return _with_scale(problem, BLUNT * float(size))


def with_estimated_noise(
    model: RegressionMap,
    again: Again,
    scatter: Scatter,
) -> RegressionMap:
    r"""`model`, fitted to a `blunted` problem, fitted `again` with its noise renewed until
    that stays to 0.3 %:

    - `scatter` $\tau$ in $\sigma_i^2 + \tau^2$ where the slope of the restricted
      likelihood is zero, $\sum_i |r_i|^2 / v_i^2 = \sum_i \mathrm{tr}(I - h_{ii}) / v_i$,
      $v_i = \sigma_i^2 + \tau^2$, or 0 where data scatter less than they say;
    - the scale of a robust loss whose data came without standard deviations: the median
      of $|r_i|$ between fit and left-out fit (the mean of both logarithms), over that of
      a standard normal vector of n components.

    **Raises** RuntimeError where a loss rejects so many data that the map is not
    determined. **Warns** where the noise did not settle in 12 rounds.
    """
    problem = model.problem
    if problem is None or (problem.noise is None and problem.misfit.squared):
        return model
    first = found = at_minimum(model)
    for _ in range(ROUNDS):
        now = renewed(problem, found, scatter)
        _check_kept(now, found)
        if _change(problem, now) < SETTLED:
            break
        problem = now
        model = again(problem, model)
        found = at_minimum(model)
    else:
        warnings.warn(
            f"fit: the noise has not settled in {ROUNDS} rounds: there may be two "
            "explanations of these data. Give `sigma`, or a `lam`.",
            stacklevel=4,
        )
    if problem.noise is None:
        return model
    return _told(model, first, found, scatter)


def renewed(problem: Problem, found: AtMinimum, scatter: Scatter) -> Problem:
    precision, noise = problem.precision, problem.noise
    if noise is None or precision.mean is None:
        if problem.misfit.squared:
            return problem
        return _with_scale(problem, _robust_scale(problem, found))
    tau = _additive(problem, found) if scatter == "additive" else 0.0
    weights = np.asarray(problem.weights)
    new = precision_of(noise, weights > 0 if problem.owner is None else weights, tau)
    misfit = misfit_of(new, problem.misfit.loss)
    return eqx.tree_at(lambda p: (p.precision, p.misfit), problem, (new, misfit))


def scaled(problem: Problem, found: AtMinimum) -> Problem:
    r"""All variances times $\varphi$, the reduced $\chi^2$ of a fit to `problem`, whose
    `sigma` is as given."""
    precision = problem.precision
    assert precision.mean is not None
    phi = found.spread.found * float(precision.mean)
    mean = as_scalar(float(precision.mean) / phi)
    precision = dataclasses.replace(precision, mean=mean, phi=phi)
    return eqx.tree_at(lambda p: p.precision, problem, precision)


def _change(before: Problem, now: Problem) -> float:
    """Of standard deviations, relatively: of data, and of the loss."""

    def deviations(problem: Problem):
        level, mean = np.asarray(problem.precision.level), problem.precision.mean
        scale = 1.0 if problem.misfit.squared else float(problem.misfit.scale)
        return np.append(
            (level * (1.0 if mean is None else float(mean))) ** -0.5, scale
        )

    return float(np.max(np.abs(np.log(deviations(now) / deviations(before)))))


def _with_scale(problem: Problem, scale: float) -> Problem:
    return eqx.tree_at(lambda p: p.misfit.scale, problem, as_scalar(scale))


def _robust_scale(problem: Problem, found: AtMinimum) -> float:
    seen = found.leverages
    squares = np.sqrt(seen.squares) * np.linalg.norm(seen.left_out, axis=1)
    weights = np.asarray(problem.weights)[found.data]
    median = np.median(squares * weights / np.mean(weights))
    return float(np.sqrt(median / chi2.ppf(0.5, problem.target.dim)))


def _additive(problem: Problem, found: AtMinimum) -> float:
    """Residuals and leverages are those of the last fit; where tau stays, it is the zero
    of the slope."""
    seen, noise = found.leverages, problem.noise
    assert noise is not None and problem.precision.mean is not None
    mean = float(problem.precision.mean)
    known = np.asarray(noise.precisions)[found.data]
    relative = known / (1 + problem.precision.scatter**2 * known) / mean
    if noise.axes is None:
        n = problem.target.dim
        squares, free = seen.squares / relative, n - seen.leverages.sum(1)
    else:
        sure = relative > 0
        squares = np.where(sure, seen.residuals**2, 0) / np.where(sure, relative, 1)
        free = np.where(sure, 1 - seen.leverages, 0.0)
    kept = seen.rho[:, 1].reshape(-1, *(1,) * (known.ndim - 1))
    weights = np.asarray(problem.weights)[found.data].reshape(kept.shape) * kept

    def slope(variance):
        precisions = known / (1 + variance * known)
        return np.sum(weights * (squares * precisions**2 - free * precisions))

    if slope(0.0) <= 0:
        return 0.0
    most = float(np.max(squares) + 1 / np.max(known))
    return float(root_scalar(slope, bracket=(0.0, most), rtol=1e-6).root) ** 0.5


def _check_kept(problem: Problem, found: AtMinimum) -> None:
    """By the noise that the next fit will have: from a map that all data are too far from,
    none is found."""
    if problem.misfit.squared:
        return
    left = at_each(weight_of, problem.misfit, found.leverages.squares)
    kept = int(np.sum(left > KEPT))
    least = least_inputs(problem.source, problem.energy.order) + 1
    if kept < least:
        name = type(problem.misfit.loss).__name__
        raise RuntimeError(
            f"loss: {name} rejects all but {kept} of {len(found.data)} data; {least} are "
            "needed. `sigma` may be too small; else take a larger constant, or Huber."
        )


def _told(
    model: RegressionMap, first: AtMinimum, last: AtMinimum, scatter: Scatter
) -> RegressionMap:
    """With what its summary says of the scatter."""
    problem = model.problem
    assert problem is not None and problem.precision.mean is not None
    precision: Precision = problem.precision
    phi = first.spread.phi
    assert phi is not None
    precision = dataclasses.replace(precision, phi=phi)
    if scatter == "factor":
        mean = as_scalar(float(precision.mean) / phi)  # type: ignore[arg-type]
        precision = dataclasses.replace(precision, mean=mean)
    densities = _log_density(first, phi), _log_density(last, 1.0)
    precision = dataclasses.replace(precision, log_densities=densities)
    problem = eqx.tree_at(lambda p: p.precision, problem, precision)
    return dataclasses.replace(model, problem=problem)


def _log_density(found: AtMinimum, phi: float) -> float:
    """Mean log density of each datum in the fit without it, per direction."""
    seen, problem = found.leverages, found.given
    variance = phi / found.spread.precision  # type: ignore[operator]
    q = np.asarray(problem.precision.level)[found.data]
    n = problem.target.dim
    own = seen.leverages.sum(1) / n
    wider = variance / np.maximum(1 - own, 1e-6)
    squares = np.sum(seen.left_out**2, axis=1)
    each = -0.5 * squares / wider - 0.5 * n * np.log(2 * np.pi * wider / q)
    return float(np.mean(each) / n)
