"""What each datum would miss if left out, and how much it pulls the map to itself, from
the Hessian at the minimum (mathematics: 10.1)."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._algebra.covariances import Elements
from .._algebra.small import solve_symmetric
from .._algebra.sparse import SparseSymmetric
from .._discretisation.jets import in_order, slots_of
from .._objective.losses import AbstractMisfit
from .._objective.problem import Problem, psi_jets
from .._objective.sites import Stage, at_site, sites
from .linear import AbstractSolvers


class Leverages(NamedTuple):
    """Of each of n data, in units of the mean precision: r coordinates of a residual,
    those of the ambient space or the principal axes of its precision."""

    residuals: Float[Array | np.ndarray, "n r"]
    left_out: Float[Array | np.ndarray, "n r"]
    """In the fit without the datum, to first order."""
    leverages: Float[Array | np.ndarray, "n r"]
    """The diagonal of h_ii."""
    squares: Float[Array | np.ndarray, " n"]
    """Of geodesic lengths, which residuals are to third order."""
    rho: Float[Array | np.ndarray, "n 3"]
    """Of these squares, with the first and the second derivative: what a datum costs, and
    what a robust loss leaves of its weight."""
    errors: Float[Array | np.ndarray, " n"]
    """Length of the residual left out, as the loss sees it: the root of its rho."""


def leverages(
    w: Float[Array, "KC t"],
    stage: Stage,
    hessian: SparseSymmetric,
    solvers: AbstractSolvers,
    scored: tuple[Int[Array, " n"], Int[Array, ""]] | None = None,
) -> Leverages:
    """`hessian`: at `w`.
    `scored`: the data wanted, and how many of them to look at; default all."""
    problem, (_, data) = stage.problem, sites(stage)
    jets, k = problem.data_jets, len(problem.y)
    misfit = problem.misfit
    psi = psi_jets(problem, jets, w)
    residual_of = lambda near, jet, args: misfit.residual(near, jet, args[0])

    def slope_of(near, jet, args):
        at = lambda value: residual_of(near, jet._replace(value=value), args)
        return jax.jacfwd(at)(jet.value)

    square_of = lambda near, jet, args: misfit.square(near, jet, args[0])
    arrays = (at_site(data, f, psi) for f in (residual_of, slope_of, square_of))
    elements, index = _elements(problem), jets.index
    arrays = *arrays, index
    if scored is not None:
        chosen, count = scored
        slots = slots_of(jets, k)[chosen]
        element = slots // index.shape[1]
        # each datum for itself: nothing is solved for places that are not taken
        pick = lambda a: a.reshape(-1, *a.shape[2:])[slots][:, None]
        arrays = tuple(map(pick, arrays))
        elements = Elements(pick(elements.values), elements.columns[element], count)
    residual, slope, square, index = arrays
    rho = jnp.stack([misfit.rho(square), *_derivatives(misfit, square)], axis=-1)
    covariance = solvers.positive.covariances(hessian, elements)
    share = rho[..., 1] * (problem.weights / jnp.sum(problem.weights))[index]
    h = 2 * share[:, :, None, None] * (slope @ covariance @ jnp.swapaxes(slope, -1, -2))
    moved = solve_symmetric(jnp.eye(h.shape[-1]) - h, residual)
    errors = jnp.sqrt(misfit.rho(jnp.sum(moved**2, axis=-1)))
    own = jnp.diagonal(h, axis1=2, axis2=3)
    found = residual, moved, own, square[..., None], rho, errors[..., None]
    one = (lambda a: a[:, 0]) if scored is not None else lambda a: in_order(jets, a, k)
    residual, moved, own, square, rho, errors = map(one, found)
    return Leverages(residual, moved, own, square[:, 0], rho, errors[:, 0])


def _derivatives(misfit: AbstractMisfit, squares: Float[Array, "e p"]):
    first = jax.grad(misfit.rho)
    both = lambda s: (first(s), jax.grad(first)(s))
    return jax.vmap(jax.vmap(both))(squares)


def no_leverages(problem: Problem, n: int) -> Leverages:
    q = problem.precision.relative
    r = problem.y.shape[1] if q.ndim == 1 else q.shape[1]
    zeros = lambda *shape: jnp.zeros((n, *shape))
    return Leverages(zeros(r), zeros(r), zeros(r), zeros(), zeros(3), zeros())


def _elements(problem: Problem) -> Elements:
    """Of all data."""
    jets = problem.data_jets
    ((_, _, U),) = jets.buckets
    values = jets.matrices[:, :, 0, :U] * jets.mask[:, :, None]
    values = values.reshape(*values.shape[:2], -1, problem.pattern.functions)
    return Elements(values, jets.columns[:, :U], jets.count)
