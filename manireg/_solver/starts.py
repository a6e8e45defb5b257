"""Where Newton starts: maps of low energy, all by linear solves.

The free solution, with the ambient space for N, follows the data, but leaves N where it
goes on beyond them; so it is projected, and the nearest map of the basis taken. Under a
large lambda it shrinks to the mean of the data, which may be far from N. There the same
spline of logarithms, in the tangent space at one datum, sent to N by the exponential map,
is next to geodesic regression. Maps that wind round N have no such spline: they are
followed from a lambda at which they follow the data.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, ScalarLike

from .._discretisation.jets import jet_values
from .._objective.assembly import PointHessians, assembled
from .._objective.hessian import gauss_newton
from .._objective.objective import objective
from .._objective.problem import Problem
from .._objective.sites import Stage
from .._objective.wavelengths import anchor
from ..manifolds import Euclidean
from .linear import AbstractSolvers
from .minimise import Method, gauge, stage_of

STRIDE = 100.0  # largest step of lambda on the way from a start


def starts_of(
    problem: Problem,
    lam: ScalarLike,
    factors: Sequence[float],
    method: Method,
    solvers: AbstractSolvers,
) -> tuple[Float[Array, "n KC t"], Float[Array, " n"]]:
    """A start for each of `factors`, and the lambda of its first solve: the free solution
    at that multiple of lambda, below 1 at no more than the anchor. Where Newton moves a
    map on N, made a map into N; and that of a factor of 1 or more is the spline of
    logarithms, if its objective is lower."""
    direct = np.array(factors) >= 1
    lams = lam * jnp.asarray(factors)
    lams = jnp.where(direct, lams, jnp.minimum(lams, anchor(problem)))
    first = jnp.where(direct, lam, jnp.minimum(lam, STRIDE * lams))
    free = jax.lax.map(lambda lam: free_solution(problem, lam, solvers), lams)
    stage = stage_of(problem, lam, gauge(problem), method, free[0])
    if not stage.energy.on_target or stage.patches is not None:
        return free, first

    project, exp = problem.target.project, problem.target.exp
    datum, logarithms = _logarithms(problem)
    values = lambda w: jet_values(problem.energy_jets, w)[:, :, 0]
    as_points = lambda v: v.reshape(*v.shape[:2], *problem.target.point_shape)
    on_target = lambda w: project(as_points(values(w) + problem.origin))
    spline = values(_spline(problem, logarithms, lam, solvers))
    images = [*jax.vmap(on_target)(free), exp(datum, as_points(spline))]
    maps = _nearest_maps(
        problem, jnp.stack([a.reshape(spline.shape) for a in images]), solvers
    )
    finite = jnp.all(jnp.isfinite(maps), axis=(1, 2), keepdims=True)
    maps = jnp.where(finite, maps, jnp.concatenate([free, free[:1]]))
    totals = jax.lax.map(lambda w: objective(w, stage)[0], maps)
    totals = jnp.nan_to_num(totals, nan=jnp.inf)
    lower = direct & (totals[-1] < totals[:-1])
    return jnp.where(lower[:, None, None], maps[-1], maps[:-1]), first


def _logarithms(problem: Problem):
    """The datum next to the mean of all, and log of the data there, flattened."""
    target, y = problem.target, problem.y
    away = jnp.sum((y - problem.origin) ** 2, axis=1)
    middle = jnp.argmin(jnp.where(problem.weights > 0, away, jnp.inf))
    points = y.reshape(-1, *target.point_shape)
    logarithms = target.log(points[middle], points).reshape(y.shape)
    return points[middle], jnp.nan_to_num(logarithms)


def _nearest_maps(
    problem: Problem, images: Float[Array, "n e p t"], solvers: AbstractSolvers
) -> Float[Array, "n KC t"]:
    """Of the basis, by least squares over the quadrature points."""
    jets, weights = problem.energy_jets, problem.energy_weights
    places = problem.energy_places
    mass = PointHessians(weights[:, :, None, None], jets, places, rows=(0,))
    factor = solvers.positive.init(assembled(problem.pattern, (mass,)), {})

    size = problem.pattern.size
    _, pull = jax.vjp(
        lambda w: jet_values(jets, w)[:, :, 0], jnp.zeros((size, images.shape[-1]))
    )
    offset = weights[:, :, None] * (images - problem.origin)
    rhs = jax.vmap(lambda v: pull(v)[0])(offset)
    sides = jnp.moveaxis(rhs, 0, 1).reshape(size, 1, -1)
    solution = solvers.positive.compute(factor, sides, {})[0]
    return jnp.moveaxis(solution.reshape(size, *rhs.shape[::2]), 1, 0)


def free_solution(
    problem: Problem, lam: ScalarLike, solvers: AbstractSolvers
) -> Float[Array, "KC t"]:
    """The minimiser with N = R^t: a thin-plate spline, one linear solve."""
    if problem.free_jets is not None:
        problem = eqx.tree_at(lambda p: p.energy_jets, problem, problem.free_jets)
    return _flat_solution(problem, lam, solvers)


def _spline(problem: Problem, y, lam, solvers: AbstractSolvers) -> Float[Array, "KC t"]:
    """The same with the energy of the source itself, of other data around 0."""
    zero = jnp.zeros_like(problem.origin)
    other = eqx.tree_at(lambda p: (p.y, p.origin), problem, (y, zero))
    return _flat_solution(other, lam, solvers)


def _flat_solution(problem: Problem, lam, solvers: AbstractSolvers):
    where = lambda p: (p.target, p.energy, p.terms)
    energy = problem.energy.penalised()
    flat = eqx.tree_at(where, problem, (Euclidean(problem.y.shape[1]), energy, ()))
    w = jnp.zeros((problem.pattern.size, problem.y.shape[1]))
    stage = Stage(flat, lam, 0.0, energy)
    gradient = jax.grad(lambda w: objective(w, stage)[0])(w)
    # every coordinate has the same matrix
    one = Stage(_first_coordinate(flat), lam, 0.0, energy.of_coordinate())
    factor = solvers.positive.init(gauss_newton(w[:, :1], one), {})
    return -solvers.positive.compute(factor, gradient[:, None], {})[0][:, 0]


def _first_coordinate(problem: Problem) -> Problem:
    where = lambda p: (p.target, p.y, p.origin)
    coordinate = (Euclidean(1), problem.y[:, :1], problem.origin[:1])
    return eqx.tree_at(where, problem, coordinate)
