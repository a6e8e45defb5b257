"""What each datum would miss if left out, from the Hessian at the minimum (mathematics:
10.1)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._discretisation.jets import in_order
from .._objective.hessian import gauss_newton
from .._objective.problem import psi_jets
from .._objective.sites import Stage, at_site, sites
from .._objective.terms import project_flat
from .linear import DirectSolvers


def left_out_errors(
    w: Float[Array, "KC t"], stage: Stage, solvers: DirectSolvers
) -> Float[Array, " k"]:
    """Length of each datum's residual in the fit without it, to first order."""
    problem, (_, data) = stage.problem, sites(stage)
    jets, k, t = problem.data_jets, len(problem.y), problem.y.shape[1]
    psi = psi_jets(problem, jets, w)
    slope = lambda near, jet, _: jax.jacfwd(lambda q: project_flat(near, q))(jet.value)
    landed = lambda near, jet, _: project_flat(near, jet.value)
    residual = at_site(data, landed, psi) - problem.y[jets.index]
    projection = at_site(data, slope, psi)

    # J_i^T as columns: basis values (U) times D pi (t x t), one per datum and component
    columns = jnp.einsum("epu,eprt->eputr", jets.matrices[:, :, 0], projection)
    columns = columns * jets.mask[:, :, None, None, None]
    places = jnp.broadcast_to(jets.columns[:, None], columns.shape[:3])
    owner = jnp.broadcast_to(jets.index[:, :, None], columns.shape[:3])
    rhs = jnp.zeros((len(w), t, k, t))
    rhs = rhs.at[places, :, owner].add(columns)
    solver = solvers.positive
    state = solver.init(gauss_newton(w, stage), {})
    solution, _, _ = solver.compute(state, rhs.reshape(len(w), t, k * t), {})
    solution = solution.reshape(len(w), t, k, t)
    leverage = jnp.einsum("wtkr,wtkq->krq", rhs, solution)
    share = problem.weights / jnp.sum(problem.weights)
    residuals = in_order(jets, residual, k)
    left = jnp.eye(t) - 2 * share[:, None, None] * leverage
    return jnp.linalg.norm(jnp.linalg.solve(left, residuals[..., None])[..., 0], axis=1)
