"""Where terms are summed: two families of points, those of the quadrature and the data."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int, ScalarLike

from .._discretisation.jets import Jets
from .._discretisation.partial_derivatives import rows_of_order
from ..manifolds import AbstractManifold
from .energies import AbstractEnergy
from .losses import Pull
from .patches import Patches
from .problem import Problem, data_weights
from .terms import AbstractTerm, jet_of


class Stage(eqx.Module):
    """What stays fixed during one Newton solve: the `args` of the objective."""

    problem: Problem
    lam: ScalarLike
    gamma: ScalarLike
    energy: AbstractEnergy
    """That of the problem, or its penalised one."""
    patches: Patches | None = None
    """What a point cloud is near the map; None: the target itself, everywhere."""


class Site(eqx.Module):
    """Points in elements, what each weighs, and the terms that are summed over them."""

    jets: Jets
    places: tuple[Int[Array, "_ _"], ...]
    """For each bucket of elements, where its pairs of centres are in the pattern."""
    weights: Float[Array, "e p"]
    terms: tuple[AbstractTerm, ...]
    arguments: tuple[Any, ...]
    """Of each term, at each point."""
    target: AbstractManifold
    near: Any
    """A patch of the target for each point, or None for the target itself."""
    dim: int = eqx.field(static=True)

    @property
    def rows(self) -> np.ndarray:
        """Of a jet, those that a term reads."""
        every = np.arange(self.jets.matrices.shape[2])
        read = sorted({order for term in self.terms for order in term.orders})
        return np.concatenate([every[rows_of_order(self.dim, order)] for order in read])


def sites(stage: Stage) -> tuple[Site, Site]:
    problem, patches = stage.problem, stage.patches

    def site(place, jets, places, weights, near, *terms):
        terms += tuple((t, a) for t, a in problem.terms if t.place == place)
        at_points = jax.tree.map(lambda a: a[jets.index], tuple(a for _, a in terms))
        terms = tuple(term for term, _ in terms)
        where = jets, places, weights, terms, at_points
        return Site(*where, problem.target, near, problem.basis.dim)

    quadrature, data = patches.near if patches else (None, None)
    where = problem.energy_jets, problem.energy_places, problem.energy_weights
    energy = stage.energy, problem.energy_arguments
    smooth = site("quadrature", *where, quadrature, energy, (Pull(), ()))
    where = problem.data_jets, problem.data_places, data_weights(problem)
    misfit = problem.misfit, (problem.y, problem.precision.relative)
    fitted = site("data", *where, data, misfit)
    return smooth, fitted


def misfit_alone(data: Site) -> Site:
    """The data, of which users' terms are none."""
    return dataclasses.replace(data, terms=data.terms[:1], arguments=data.arguments[:1])


def at_points(site: Site, f: Callable, near, jets: Float[Array, "p J t"], arguments):
    """`f(near, jet, arguments)` at every point of an element."""
    one = lambda near, rows, arguments: f(near, jet_of(rows, site.dim), arguments)
    if near is None:
        return jax.vmap(lambda *args: one(site.target, *args))(jets, arguments)
    return jax.vmap(one)(near, jets, arguments)


def at_site(site: Site, f: Callable, jets: Float[Array, "e p J t"]):
    """`f(near, jet, arguments)` at every point of the site."""
    of_element = lambda *args: at_points(site, f, *args)
    return jax.vmap(of_element)(site.near, jets, site.arguments)
