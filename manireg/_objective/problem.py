"""Data and discretisation of one regression, as all that follows sees them."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from .._algebra.sparse import SparsityPattern
from .._discretisation.jets import Jets, in_order, jet_values
from .._discretisation.local_polynomials import LocalPolynomials
from .._source import AbstractSource
from .._sources.noise import Noise
from ..manifolds import AbstractManifold
from .energies import AbstractEnergy
from .losses import AbstractMisfit
from .noise import Precision
from .terms import AbstractTerm


class Problem(eqx.Module):
    """Built by `make_problem`, solved by `solve` for any lambda.

    `y` and `weights` are leaves: replace them (`eqx.tree_at`) to solve for other outputs
    or other folds with the same compiled program.
    """

    source: AbstractSource
    target: AbstractManifold
    basis: LocalPolynomials
    energy_jets: Jets
    """Value and intrinsic derivatives at the quadrature points."""
    free_jets: Jets | None
    """The same with ambient derivatives, for the free start: affine maps of the ambient
    space then cost nothing. None on a flat source, where they are the same."""
    energy_weights: Float[Array, "e p"]
    data_jets: Jets
    """Values at the data."""
    x: Float[Array, "k s"]
    y: Float[Array, "k t"]
    weights: Float[Array, " k"]
    precision: Precision
    misfit: AbstractMisfit
    """The data term."""
    noise: Noise | None
    """What is known of it, for inference."""
    owner: Int[np.ndarray, " k"] | None
    """Where an x is known within errors only, and rows are values that it may have: of
    which datum each is one; None: rows are data."""
    origin: Float[Array, " t"]
    """Psi = origin + A w: data far from zero cost no digits."""
    pattern: SparsityPattern
    energy_places: tuple[Int[Array, "_ _"], ...]
    """For each bucket of elements, where its pairs of centres are in the pattern."""
    data_places: tuple[Int[Array, "_ _"], ...]
    energy: AbstractEnergy
    energy_arguments: PyTree[Float[Array, "Q ..."]]
    terms: tuple[tuple[AbstractTerm, PyTree[Array]], ...]
    """Others, with what they read at each point."""
    data_volume: Float[Array, ""]
    """Of the part of the source that the data fill: less than `volume` where they
    cluster."""
    dim: int = eqx.field(static=True)
    """m, of what is integrated over."""

    @property
    def volume(self) -> Float[Array, ""]:
        return jnp.sum(self.energy_weights)


def data_weights(problem: Problem) -> Float[Array, "e p"]:
    """weight_i / sum_j weight_j, arranged in the elements of the data jets."""
    share = problem.weights / jnp.sum(problem.weights)
    return share[problem.data_jets.index] * problem.data_jets.mask


def number_of_data(problem: Problem) -> int:
    """Independent ones, of positive weight."""
    heavy = np.asarray(problem.weights) > 0
    if problem.owner is None:
        return int(np.sum(heavy))
    return len(np.unique(problem.owner[heavy]))


def psi_jets(problem: Problem, jets: Jets, w: Float[Array, "KC t"]):
    """Jets of Psi = origin + A w, `(e, p, J, t)`."""
    return jet_values(jets, w).at[:, :, 0].add(problem.origin)


def psi_at_data(problem: Problem, w: Float[Array, "KC t"]) -> Float[Array, "k t"]:
    """In the order of the data."""
    values = psi_jets(problem, problem.data_jets, w)[:, :, 0]
    return in_order(problem.data_jets, values, len(problem.y))
