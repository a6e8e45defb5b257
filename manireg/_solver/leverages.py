"""What each datum would miss if left out, from the Hessian at the minimum (mathematics:
10.1)."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._algebra.chunks import map_chunks
from .._algebra.sparse import SparseSymmetric
from .._discretisation.jets import in_order
from .._objective.problem import psi_jets
from .._objective.sites import Stage, at_site, sites
from .._objective.terms import project_flat
from .linear import AbstractSolvers

CHUNK_BYTES = 8_000_000  # of blocks of the inverse, gathered at a time


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
    inverse = solvers.positive.selected_inverse(hessian)
    ((_, _, U),), (places,) = jets.buckets, problem.data_places
    values = jets.matrices[:, :, 0, :U].reshape(
        *projection.shape[:2], -1, problem.pattern.functions
    )
    covariance = _at_data(inverse, values, places)
    leverage = projection @ covariance @ jnp.swapaxes(projection, -1, -2)
    share = (problem.weights / jnp.sum(problem.weights))[jets.index]
    left = jnp.eye(t) - 2 * share[:, :, None, None] * leverage
    moved = jnp.linalg.solve(left, residual[..., None])[..., 0]
    return jnp.linalg.norm(in_order(jets, moved, k), axis=1)


def _at_data(
    inverse: Float[Array, "nnz b b"], values: Float[Array, "e p L f"], places: Any
) -> Float[Array, "e p t t"]:
    """Of Psi at each datum the inverse Hessian: the sum of the blocks of all pairs of
    centres i <= j, times the values of their functions."""
    L, f = values.shape[2:]
    i, j = np.triu_indices(L)
    b = inverse.shape[-1]

    def of_element(arrays):
        values, places = arrays
        blocks = inverse.at[places].get(mode="fill", fill_value=0.0)
        blocks = blocks.reshape(len(i), f, b // f, f, b // f)
        half = jnp.einsum("qnf,nfagb->qnagb", values[:, i], blocks)
        each = jnp.einsum("qnagb,qng->qnab", half, values[:, j])
        off = jnp.sum(each * (i < j)[:, None, None], axis=1)
        own = jnp.sum(each * (i == j)[:, None, None], axis=1)
        return own + off + jnp.swapaxes(off, 1, 2)

    size = 8 * len(i) * b * b
    return map_chunks(of_element, (values, places), CHUNK_BYTES / size)
