"""Where Newton starts: maps of low energy, all by linear solves.

The free solution, with the ambient space for N, follows the data, but leaves N where it
goes on beyond them; so it is projected, and the nearest map of the basis taken. Under a
large lambda it shrinks to the mean of the data, which may be far from N. There the same
spline of logarithms, in the tangent space at one datum, sent to N by the exponential map,
is next to geodesic regression. Maps that wind round N have no such spline: they are
followed from a lambda at which they follow the data.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, ScalarLike

from .._discretisation.jets import Jets, jet_values
from .._objective.assembly import PointHessians, assembled
from .._objective.objective import objective
from .._objective.problem import Problem, data_weights
from .._objective.wavelengths import anchor
from .linear import AbstractSolvers
from .minimise import Method, gauge, stage_of

STRIDE = 10**0.5  # largest step of the wavelength on the way from a start


def stride(problem: Problem) -> float:
    """The same of lambda."""
    return STRIDE ** (2 * problem.energy.order)


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
    first = jnp.where(direct, lam, jnp.minimum(lam, stride(problem) * lams))
    free = jax.lax.map(lambda lam: free_solution(problem, lam, solvers), lams)
    stage = stage_of(problem, lam, gauge(problem), method, free[0])
    if not stage.energy.on_target or stage.patches is not None:
        return free, first

    project, exp = problem.target.project, problem.target.exp
    datum, logarithms = _logarithms(problem)
    values = lambda w: jet_values(problem.energy_jets, w)[:, :, 0]
    as_points = lambda v: v.reshape(*v.shape[:2], *problem.target.point_shape)
    on_target = lambda w: project(as_points(values(w) + problem.origin))
    logarithms = logarithms[problem.data_jets.index]
    jets = problem.energy_jets
    spline = values(_spline(problem, jets, logarithms, lam, solvers))
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
    rows = jets.matrices.shape[2]
    value = (np.arange(rows) == 0) * weights[:, :, None]
    offset = jnp.moveaxis(images - problem.origin, 0, -2)
    wanted = offset.reshape(*weights.shape, 1, -1)
    no_data = jnp.zeros_like(problem.data_jets.mask)
    nothing = jnp.zeros((*no_data.shape, wanted.shape[-1]))
    w = _least_squares(problem, jets, value, wanted, no_data, nothing, solvers)
    return jnp.moveaxis(w.reshape(len(w), len(images), -1), 1, 0)


def free_solution(
    problem: Problem, lam: ScalarLike, solvers: AbstractSolvers
) -> Float[Array, "KC t"]:
    """The minimiser with N = R^t: a thin-plate spline, one linear solve."""
    free = problem.free_jets
    jets = problem.energy_jets if free is None else free
    y = (problem.y - problem.origin)[problem.data_jets.index]
    return _spline(problem, jets, y, lam, solvers)


def _spline(problem: Problem, jets: Jets, y, lam, solvers: AbstractSolvers):
    """Of data `y` around 0, with the energy of the given jets."""
    flat = lambda args: problem.energy.flat(problem.basis.dim, args)
    at_points = jax.tree.map(lambda a: a[jets.index], problem.energy_arguments)
    axes = 0 if jax.tree.leaves(at_points) else None
    size = jets.index.shape[1]
    costs, wanted = jax.vmap(
        jax.vmap(flat, axes, axis_size=size), axes, axis_size=len(jets.index)
    )(at_points)
    costs = lam * problem.energy_weights[:, :, None] * costs
    share = data_weights(problem) * problem.precision.level[problem.data_jets.index]
    return _least_squares(problem, jets, costs, wanted, share, y, solvers)


def _least_squares(
    problem: Problem,
    jets: Jets,
    costs: Float[Array, "e p J"],
    wanted: Float[ArrayLike, "e p #J #n"],
    share: Float[Array, "d r"],
    y: Float[Array, "d r n"],
    solvers: AbstractSolvers,
) -> Float[Array, "KC n"]:
    """Coefficients of the function that comes nearest to `wanted` in its jets and to `y`
    at the data, of all n at once: each has the same matrix."""
    data = problem.data_jets
    rows = costs.shape[-1]
    families = (
        PointHessians(
            costs[..., None] * jnp.eye(rows),
            jets,
            problem.energy_places,
            rows=tuple(range(rows)),
        ),
        PointHessians(share[:, :, None, None], data, problem.data_places, rows=(0,)),
    )
    matrix = assembled(problem.pattern, families)

    def pulled(jets, forces):
        """A^T forces."""
        along = jnp.einsum("epju,epjn->eun", jets.matrices, forces)
        zeros = jnp.zeros((problem.pattern.size, y.shape[-1]))
        return zeros.at[jets.columns].add(along)

    right = pulled(data, (share[:, :, None] * y)[:, :, None])
    forces = costs[..., None] * wanted
    right += pulled(jets, jnp.broadcast_to(forces, (*costs.shape, y.shape[-1])))
    factor = solvers.positive.init(matrix, {})
    return solvers.positive.compute(factor, right[:, None], {})[0][:, 0]
