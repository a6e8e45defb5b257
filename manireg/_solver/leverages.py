"""What each datum would miss if left out, from the Hessian at the minimum (mathematics:
10.1)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._algebra.covariances import Elements
from .._algebra.small import solve_symmetric
from .._algebra.sparse import SparseSymmetric
from .._discretisation.jets import in_order
from .._objective.problem import psi_jets
from .._objective.sites import Stage, at_site, sites
from .._objective.terms import project_flat
from .linear import AbstractSolvers


def left_out_errors(
    w: Float[Array, "KC t"],
    stage: Stage,
    hessian: SparseSymmetric,
    solvers: AbstractSolvers,
) -> Float[Array, " k"]:
    """Length of each datum's residual in the fit without it, to first order. `hessian`:
    at `w`; of its inverse are needed the blocks of centres that share a datum."""
    problem, (_, data) = stage.problem, sites(stage)
    jets, k, t = problem.data_jets, len(problem.y), problem.y.shape[1]
    psi = psi_jets(problem, jets, w)
    slope = lambda near, jet, _: jax.jacfwd(lambda q: project_flat(near, q))(jet.value)
    landed = lambda near, jet, _: project_flat(near, jet.value)
    residual = at_site(data, landed, psi) - problem.y[jets.index]
    projection = at_site(data, slope, psi)
    ((_, _, U),), (places,) = jets.buckets, problem.data_places
    values = jets.matrices[:, :, 0, :U] * jets.mask[:, :, None]
    values = values.reshape(*values.shape[:2], -1, problem.pattern.functions)
    elements = Elements(values, jets.columns[:, :U], jets.count, places)
    covariance = solvers.positive.covariances(hessian, elements)
    leverage = projection @ covariance @ jnp.swapaxes(projection, -1, -2)
    share = (problem.weights / jnp.sum(problem.weights))[jets.index]
    left = jnp.eye(t) - 2 * share[:, :, None, None] * leverage
    moved = solve_symmetric(left, residual)
    return jnp.linalg.norm(in_order(jets, moved, k), axis=1)
