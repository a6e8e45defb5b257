"""Where Newton starts: maps of low energy, all by linear solves.

The free solution, with the ambient space for N, follows the data, but leaves N where it
goes on beyond them; so it is projected, and the nearest map of the basis taken. Under a
large lambda it shrinks to the mean of the data, which may be far from N. There the same
spline of logarithms, in the tangent space at one datum, sent to N by the exponential map,
is next to geodesic regression.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, ScalarLike

from ._assembly import VALUE, PointHessians, assembled
from ._hessian import gauss_newton
from ._jets import jet_values
from ._linear_solvers import DirectSolvers
from ._minimise import Method, gauge, stage_of
from ._objective import Stage, objective
from ._problem import Problem
from .manifolds import Euclidean


def starts_of(
    problem: Problem,
    lam: ScalarLike,
    factors: Sequence[float],
    method: Method,
    solvers: DirectSolvers,
) -> Float[Array, "n KC t"]:
    """Starts, as many as `factors`: the free solutions at these multiples of lambda. Where
    Newton moves a map on N, they and the spline of logarithms are made maps into N, and
    those of lowest objective kept."""
    lams = lam * jnp.asarray(factors)
    free = lambda y, origin, lam: free_solution(
        eqx.tree_at(lambda p: (p.y, p.origin), problem, (y, origin)), lam, solvers
    )
    nowhere = jnp.zeros((problem.pattern.size, problem.y.shape[1]))
    stage = stage_of(problem, lam, gauge(problem), method, nowhere)
    if not stage.projected or stage.local is not None:
        return jax.lax.map(lambda lam: free(problem.y, problem.origin, lam), lams)

    datum, logarithms = _logarithms(problem)
    stacked = lambda many, one: jnp.stack([*[many] * len(factors), one])
    lanes = (
        stacked(problem.y, logarithms),
        stacked(problem.origin, jnp.zeros_like(problem.origin)),
        jnp.append(lams, lam),
    )
    splines = jax.lax.map(lambda lane: free(*lane), lanes)
    values = lambda w: jet_values(problem.energy_jets, w)[:, :, 0]
    shape = problem.target.point_shape
    points = lambda v: v.reshape(*v.shape[:-1], *shape)
    images = [
        *(
            problem.target.project(points(values(w) + problem.origin))
            for w in splines[:-1]
        ),
        problem.target.exp(datum, points(values(splines[-1]))),
    ]
    images = jnp.stack(images).reshape(len(lanes[2]), *values(splines[0]).shape)
    starts = _nearest_maps(problem, images, solvers)
    finite = jnp.all(jnp.isfinite(starts), axis=(1, 2), keepdims=True)
    starts = jnp.where(finite, starts, splines.at[-1].set(splines[0]))
    totals = jax.lax.map(lambda w: objective(w, stage)[0], starts)
    order = jnp.argsort(jnp.nan_to_num(totals, nan=jnp.inf))
    return starts[order[: len(factors)]]


def _logarithms(problem: Problem):
    """The datum next to the mean of all, and log of the data there, flattened."""
    target, y = problem.target, problem.y
    away = jnp.sum((y - problem.origin) ** 2, axis=1)
    middle = jnp.argmin(jnp.where(problem.weights > 0, away, jnp.inf))
    points = y.reshape(-1, *target.point_shape)
    logarithms = target.log(points[middle], points).reshape(y.shape)
    return points[middle], jnp.nan_to_num(logarithms)


def _nearest_maps(
    problem: Problem, images: Float[Array, "n e p t"], solvers: DirectSolvers
) -> Float[Array, "n KC t"]:
    """Of the basis, by least squares over the quadrature points."""
    jets, weights = problem.energy_jets, problem.energy_weights
    one = _first_coordinate(problem)
    nothing = jnp.zeros((*problem.data_jets.mask.shape, 1, 1))
    mass = PointHessians(weights[:, :, None, None], nothing)
    factor = solvers.positive.init(assembled(one, mass, VALUE), {})

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
    problem: Problem, lam: ScalarLike, solvers: DirectSolvers
) -> Float[Array, "KC t"]:
    """The minimiser with N = R^t: a thin-plate spline, one linear solve."""
    free = free_problem(problem)
    w = jnp.zeros((problem.pattern.size, problem.y.shape[1]))
    stage = Stage(free, lam, 0.0, False)
    gradient = jax.grad(lambda w: objective(w, stage)[0])(w)
    # every coordinate has the same matrix
    one = eqx.tree_at(lambda s: s.problem, stage, _first_coordinate(free))
    factor = solvers.positive.init(gauss_newton(w[:, :1], one), {})
    return -solvers.positive.compute(factor, gradient[:, None], {})[0][:, 0]


def free_problem(problem: Problem) -> Problem:
    """The same data, ambient space as the target."""
    where = lambda p: (p.target, p.energy_jets)
    ambient = Euclidean(problem.y.shape[1])
    return eqx.tree_at(where, problem, (ambient, problem.free_jets))


def _first_coordinate(problem: Problem) -> Problem:
    where = lambda p: (p.target, p.y, p.origin)
    coordinate = (Euclidean(1), problem.y[:, :1], problem.origin[:1])
    one = eqx.tree_at(where, problem, coordinate)
    if problem.tension is None:
        return one
    derivative = problem.tension.derivative[:, :1]
    return eqx.tree_at(lambda p: p.tension.derivative, one, derivative)
