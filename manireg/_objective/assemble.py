"""A problem from a basis, a quadrature and data: jets, pattern, what terms read."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, Int, PyTree, ScalarLike

from .._algebra.sparse import sparsity
from .._discretisation.domain import Domain
from .._discretisation.jets import Jets, bucket_centres, jets_of, value_jets
from .._discretisation.local_polynomials import LocalPolynomials
from .._input.precision import as_scalar
from .._sources.noise import Noise
from .energies import AbstractEnergy, IntrinsicEnergy
from .noise import equal_precisions, misfit_of, precision_of
from .problem import Problem
from .robust import AbstractLoss, Squared
from .terms import AbstractTerm


def assemble_problem(
    source,
    target,
    basis,
    domain: Domain,
    x,
    y,
    weights,
    energy: AbstractEnergy | None = None,
    terms: Sequence[AbstractTerm] = (),
    data_volume: ScalarLike | None = None,
    noise: Noise | None = None,
    loss: AbstractLoss = Squared(),
) -> Problem:
    """The same from a basis and a quadrature of your own; inputs are not checked."""
    if data_volume is None:
        data_volume = np.sum(np.asarray(domain.weights))
    energy = IntrinsicEnergy() if energy is None else energy
    if noise is None:
        relative = equal_precisions(len(y))
    else:
        relative = precision_of(noise, np.asarray(weights) > 0)
    order = max(0, *energy.orders, *(o for term in terms for o in term.orders))
    geodesics = domain.geodesics(order)
    energy_jets = jets_of(basis, geodesics, order)
    free_jets = None
    if np.any(straight := geodesics[:, 1 + domain.dim :]):
        straight[:] = 0
        free_jets = jets_of(basis, geodesics, order)
    data_jets = value_jets(basis, x, energy_jets)
    pattern, energy_places, data_places = pattern_of(basis, energy_jets, data_jets)
    at_points = np.asarray(domain.weights)[np.asarray(energy_jets.index)]
    share = np.asarray(weights) / np.sum(np.asarray(weights))
    places = {"quadrature": (domain.points, None), "data": (x, y)}
    return Problem(
        source=source,
        target=target,
        basis=basis,
        energy_jets=energy_jets,
        free_jets=free_jets,
        energy_weights=jax.device_put(at_points * np.asarray(energy_jets.mask)),
        data_jets=data_jets,
        x=x,
        y=y,
        weights=weights,
        precision=relative,
        misfit=misfit_of(relative, loss),
        noise=noise,
        owner=None,
        origin=jax.device_put(share @ np.asarray(y)),
        pattern=pattern,
        energy_places=energy_places,
        data_places=data_places,
        energy=energy,
        energy_arguments=_arrays(energy.arguments(domain.points, None)),
        terms=tuple((t, _arrays(t.arguments(*places[t.place]))) for t in terms),
        data_volume=as_scalar(data_volume),
        dim=source.sampled.dim,
    )


def with_nodes(
    problem: Problem,
    x: Float[np.ndarray, "nodes s"],
    owner: Int[np.ndarray, " nodes"],
    weights: Float[np.ndarray, " nodes"],
) -> Problem:
    """The same problem, basis and energy with data at several places each: `owner` is of
    which datum each place is one."""
    data_jets = value_jets(problem.basis, x, problem.energy_jets)
    pattern, energy_places, data_places = pattern_of(
        problem.basis, problem.energy_jets, data_jets
    )
    of_owner = lambda tree: jax.device_put(
        jax.tree.map(lambda a: np.asarray(a)[owner], tree)
    )
    terms = tuple(
        (term, of_owner(args) if term.place == "data" else args)
        for term, args in problem.terms
    )
    relative = of_owner(problem.precision.relative)
    precision = eqx.tree_at(lambda p: p.relative, problem.precision, relative)
    noise = None if problem.noise is None else of_owner(problem.noise)
    changes = {
        "x": jax.device_put(x),
        "y": of_owner(problem.y),
        "weights": jax.device_put(weights),
        "owner": owner,
        "precision": precision,
        "noise": noise,
        "terms": terms,
        "data_jets": data_jets,
        "pattern": pattern,
        "energy_places": energy_places,
        "data_places": data_places,
    }
    return dataclasses.replace(problem, **changes)


def _arrays(arguments: PyTree) -> PyTree:
    """Copies: JAX may share the memory of NumPy arrays, which may change."""
    return jax.device_put(jax.tree.map(np.array, arguments))


def pattern_of(basis: LocalPolynomials, energy_jets: Jets, data_jets: Jets):
    """Pattern of the Hessian, and the places in it of the energy's and the data's
    elements."""
    energy, data = (bucket_centres(j, basis.size) for j in (energy_jets, data_jets))
    supports = np.asarray(basis.centres), np.asarray(basis.widths)
    pattern, places = sparsity(
        [*energy, *data], *supports, basis.size, on_curve=basis.dim == 1
    )
    return pattern, places[: len(energy)], places[len(energy) :]
