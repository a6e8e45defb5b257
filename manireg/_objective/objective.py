"""The objective: one function of the coefficients.

    E(w) = sum over terms of f sum_q weight_q rho(|residual(A_q w)|^2)

A_q are the jets (fixed, sparse, linear) at quadrature points and data; a term is the loss,
an energy times lambda, the pull towards N times gamma, or one of the user's. Value,
gradient (autodiff) and Hessian (`hessian.py`) each are one loop over the two sites.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .losses import largest_distance
from .problem import psi_jets
from .sites import Stage, at_site, sites


class Energies(eqx.Module):
    """The parts of the objective at a solution."""

    loss: Float[Array, ""]
    """(Weighted) mean of the squared geodesic errors on the data, times their precision
    over the mean one, under the loss."""
    energy: Float[Array, ""]
    """S, what lambda multiplies: the Eells energy, that of another order, or with the
    tension's."""
    off_manifold: Float[Array, ""]
    """Largest distance of Psi to N, before the final projection."""
    terms: dict[str, Float[Array, ""]]
    """Every term by its name, before it is multiplied by lambda, gamma or its factor."""

    @property
    def eells(self) -> Float[Array, ""]:
        """`energy`, of order 2."""
        if "eells" not in self.terms:
            raise AttributeError("energies: not of order 2; `energy` is what there is.")
        return self.terms["eells"]


def objective(
    w: Float[Array, "KC t"], stage: Stage
) -> tuple[Float[Array, ""], Energies]:
    problem = stage.problem
    total, values, densities = jnp.zeros(()), {}, {}
    for site in sites(stage):
        jets = psi_jets(problem, site.jets, w)

        def of_point(near, jet, arguments, terms=site.terms):
            pairs = zip(terms, arguments, strict=True)
            return [term.density(near, jet, args) for term, args in pairs]

        for term, density in zip(site.terms, at_site(site, of_point, jets)):
            densities[term.name] = density
            values[term.name] = jnp.sum(site.weights * density)
            total += term.factor(stage.lam, stage.gamma) * values[term.name]
    gap = largest_distance(densities["off_manifold"], problem.energy_jets.mask)
    energies = Energies(values["loss"], values[stage.energy.name], gap, values)
    return total, energies
