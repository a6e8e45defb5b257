r"""Inputs known within errors: the true ones are latent, each with its prior.

The likelihood of a datum is the mean of $\exp(-d^2(y_i, \Phi(\xi)) / 2 \sigma^2)$ over the
inputs $\xi$ that it may have. It is maximised by expectation and maximisation (Dempster,
Laird and Rubin 1977): each datum stands at several nodes $\xi_{ij}$, weighed by how likely
they are under the map before; a fit to these is an ordinary one. Noise and lambda are
renewed with the weights, lambda by $k \lambda S = \hat\sigma^2 (\mathrm{edf} - d_0)$ (the
fixed point of the restricted likelihood: Fellner 1986, Schall 1991).
"""

import dataclasses
import warnings
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int

from .._discretisation.jets import in_order
from .._objective.arguments import argument
from .._objective.assemble import with_nodes
from .._objective.problem import Problem, psi_jets
from .._objective.sites import at_site, sites
from .._programs.program import program
from .._solver.at_minimum import at_minimum
from .._solver.minimise import projected_stage
from .._solver.model import RegressionMap
from .._solver.solve import solve
from .._sources.input_errors import InputErrors
from ..manifolds._defaults.frames import orthonormal_axes
from .noise import Scatter, renewed, scaled
from .progress import Progress

REACH = 3.0  # standard deviations of a normal prior that nodes cover
FINE = 0.5  # distance of the map between nodes, in standard deviations of the noise
FEWEST, MOST = 9, 81  # nodes of a datum
STEEPER = 2.0  # the true map than the first fit, which errors have flattened
# times the lambda of the first fit: from below, since under a large one what errors have
# flattened is taken for noise, and stays flat
ROUGHER = 0.03
STEPS = 300
SETTLED = 2e-3  # largest move of a fitted value, in standard deviations of the noise
STRIDE = 3.0  # largest factor of lambda at a step


def with_latent_inputs(
    model: RegressionMap,
    errors: InputErrors,
    choose: bool,
    scatter: Scatter,
    progress: bool,
) -> RegressionMap:
    """`model`, fitted as if inputs were exact, fitted anew; its problem then has a row for
    each node. `choose`: renew lambda, too.

    **Warns** where it has not settled in 300 steps."""
    problem = model.problem
    assert problem is not None
    deviation = np.sqrt(at_minimum(model).spread.variance)
    x, owner, prior = _nodes(problem, model, errors, deviation)
    weights = np.asarray(problem.weights)
    relative = (weights / np.mean(weights[weights > 0]))[owner]
    weights = weights[owner]
    problem = with_nodes(problem, x, owner, weights * prior)
    known = problem.noise is not None
    variance, lam, w = deviation**2, float(model.lam), model.coefficients
    lam *= ROUGHER if choose else 1.0
    fitted, moved = None, np.inf
    costs, values = _at_nodes(argument(problem), model.lam, w)
    with Progress(STEPS, "steps", progress) as bar:
        for _ in range(STEPS):
            likely = relative * np.asarray(costs)[: len(x)] / (-2 * variance)
            shares = _normalised(np.log(prior) + likely, owner)
            problem = eqx.tree_at(
                lambda p: p.weights, problem, jax.device_put(weights * shares)
            )
            fitted = solve(problem, lam, warm=w, starts=(), throw=False, rtol=1e-9)
            w, before = fitted.coefficients, values
            found = at_minimum(fitted)
            spread = found.spread
            if known:
                problem = renewed(problem, found, scatter)
                if scatter == "factor":
                    problem = scaled(problem, found)
                variance = 1 / float(problem.precision.mean)  # type: ignore[arg-type]
            else:
                variance = spread.found
            if choose:
                wanted = variance * (spread.edf - spread.null) / spread.penalty
                lam *= float(np.clip(wanted, 1 / STRIDE, STRIDE))
            costs, values = _at_nodes(argument(problem), model.lam, w)
            moved = np.max(np.abs(np.asarray(values - before))[: len(x)])
            bar.step()
            if moved < SETTLED * np.sqrt(variance):
                break
        else:
            warnings.warn(
                f"fit: latent inputs have not settled in {STEPS} steps: the map still "
                f"moves by {moved / np.sqrt(variance):.2g} standard deviations of noise.",
                stacklevel=3,
            )
    assert fitted is not None
    return dataclasses.replace(fitted, problem=problem)


def _nodes(
    problem: Problem, model: RegressionMap, errors: InputErrors, deviation: float
) -> tuple[Float[np.ndarray, "n 1"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Places, owners and prior shares: so close that the map moves less than the noise
    from one to the next. Inputs outside of the source cannot be."""
    x = np.asarray(problem.x)[:, 0]
    lower, upper = x - REACH * errors.deviation, x + REACH * errors.deviation
    normal = np.ones(len(x), bool)
    if errors.lower is not None and errors.upper is not None:
        normal = np.isnan(errors.lower)
        lower = np.where(normal, lower, errors.lower)
        upper = np.where(normal, upper, errors.upper)
    low, high = (float(v[0]) for v in problem.source.bounds)  # type: ignore[attr-defined]
    lower, upper = np.maximum(lower, low), np.minimum(upper, high)
    velocity = np.asarray(model.velocity(x)).reshape(len(x), -1, 1)
    velocity = orthonormal_axes(problem.target, np.asarray(model(x)), velocity)
    speed = np.linalg.norm(velocity[:, :, 0], axis=1)
    speed = STEEPER * max(np.quantile(speed, 0.9), 1e-300)
    wanted = np.ceil((upper - lower) * speed / (FINE * deviation))
    counts = np.clip(wanted, FEWEST, MOST).astype(int) | 1  # odd: one in the middle
    counts[errors.deviation == 0] = 1
    places, owner, prior = [], [], []
    for i, n in enumerate(counts):
        at = lower[i] + (upper[i] - lower[i]) * (np.arange(n) + 0.5) / n
        at = at if n > 1 else x[i : i + 1]
        share = np.ones(n)
        if normal[i] and n > 1:
            share = np.exp(-0.5 * ((at - x[i]) / errors.deviation[i]) ** 2)
        places.append(at)
        owner.append(np.full(n, i))
        prior.append(share / share.sum())
    places, owner, prior = map(np.concatenate, (places, owner, prior))
    return places[:, None], owner, prior


def _normalised(
    likely: Float[np.ndarray, " n"], owner: Int[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Shares of the nodes of each datum, from logarithms."""
    first = np.flatnonzero(np.append(True, np.diff(owner) != 0))
    shares = np.exp(likely - np.maximum.reduceat(likely, first)[owner])
    return shares / np.add.reduceat(shares, first)[owner]


@program(most=4)
def _at_nodes(problem: Problem, lam: Any, w: Any):
    """What each node costs, and the values of Psi there."""
    stage = projected_stage(problem, lam, w)
    (_, data), jets, k = sites(stage), problem.data_jets, len(problem.y)
    psi = psi_jets(problem, jets, w)
    cost = lambda near, jet, args: problem.misfit.density(near, jet, args[0])
    costs = in_order(jets, at_site(data, cost, psi)[..., None], k)[:, 0]
    return costs, in_order(jets, psi[:, :, 0], k)
