"""Squared lengths of shortest curves as the loss on a point cloud, by a few solves."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from .._geodesics.geodesic import geodesic
from .._input.numbers import Numbers
from .._objective.problem import Problem
from .model import RegressionMap
from .solve import solve

ROUNDS = 20
SETTLED = 1e-5  # of the size of N: largest change of a fitted value at which they stop


def solve_geodesic(problem: Problem, lam: Numbers, **options) -> RegressionMap:
    r"""`solve` with $d_N$ the length of shortest curves. A `PointCloud` measures distances
    along chords; around the fitted values $p_i$, $|\Psi(x_i) - (p_i + \log_{p_i} y_i)|^2$
    has the value and the gradient of $d_N^2$, so each solve pulls towards
    $p_i + \log_{p_i} y_i$ in place of $y_i$, until the $p_i$ stay. On other manifolds
    `solve` as it is. Options go to `solve`."""
    model = solve(problem, lam, **options)
    target: Any = problem.target
    if target.nearest(problem.y) is None:
        return model
    x = problem.source.from_ambient(problem.x)
    values = model(x)
    size = jnp.max(jnp.ptp(target.points, axis=0))
    options = {**options, "starts": ()}
    for _ in range(ROUNDS):
        pulled = values + geodesic(target, values, problem.y).velocity
        nearby = eqx.tree_at(lambda p: p.y, problem, pulled)
        model = solve(nearby, lam, **{**options, "warm": model.coefficients})
        before, values = values, model(x)
        if jnp.max(jnp.abs(values - before)) < SETTLED * size:
            break
    return model
