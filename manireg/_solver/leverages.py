"""What each datum would miss if left out, from the Hessian at the minimum (mathematics:
10.1)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._algebra.covariances import Elements
from .._algebra.small import solve_symmetric
from .._algebra.sparse import SparseSymmetric
from .._discretisation.jets import in_order, slots_of
from .._objective.problem import Problem, psi_jets
from .._objective.sites import Stage, at_site, sites
from .._objective.terms import project_flat
from .linear import AbstractSolvers


def left_out_errors(
    w: Float[Array, "KC t"],
    stage: Stage,
    hessian: SparseSymmetric,
    solvers: AbstractSolvers,
    scored: tuple[Int[Array, " n"], Int[Array, ""]] | None = None,
) -> Float[Array, "_"]:
    """Length of each datum's residual in the fit without it, to first order. `hessian`:
    at `w`.
    `scored`: the data wanted, and how many of them to look at; default all."""
    problem, (_, data) = stage.problem, sites(stage)
    jets, k, t = problem.data_jets, len(problem.y), problem.y.shape[1]
    psi = psi_jets(problem, jets, w)
    slope = lambda near, jet, _: jax.jacfwd(lambda q: project_flat(near, q))(jet.value)
    landed = lambda near, jet, _: project_flat(near, jet.value)
    residual = at_site(data, landed, psi) - problem.y[jets.index]
    projection = at_site(data, slope, psi)
    elements, index = _elements(problem), jets.index
    if scored is not None:
        chosen, count = scored
        slots = slots_of(jets, k)[chosen]
        element = slots // index.shape[1]
        # each datum for itself: nothing is solved for places that are not taken
        pick = lambda a: a.reshape(-1, *a.shape[2:])[slots][:, None]
        residual, projection, index = map(pick, (residual, projection, index))
        elements = Elements(
            pick(elements.values),
            elements.columns[element],
            count,
        )
    covariance = solvers.positive.covariances(hessian, elements)
    leverage = projection @ covariance @ jnp.swapaxes(projection, -1, -2)
    share = (problem.weights / jnp.sum(problem.weights))[index]
    left = jnp.eye(t) - 2 * share[:, :, None, None] * leverage
    moved = solve_symmetric(left, residual)
    moved = in_order(jets, moved, k) if scored is None else moved[:, 0]
    return jnp.linalg.norm(moved, axis=1)


def _elements(problem: Problem) -> Elements:
    """Of all data."""
    jets = problem.data_jets
    ((_, _, U),) = jets.buckets
    values = jets.matrices[:, :, 0, :U] * jets.mask[:, :, None]
    values = values.reshape(*values.shape[:2], -1, problem.pattern.functions)
    return Elements(values, jets.columns[:, :U], jets.count)
