"""Tension: what the first derivative costs, against the affine map of the data."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._discretisation.jets import Jets
from .._discretisation.spacing import data_spacings

THIN = 1e-2  # of the data's largest extent: across it the affine map is taken as 0


class Tension(eqx.Module):
    r"""Adds $\tau |P (D\Psi - A)|^2 / h^2$ to the energy density."""

    strength: Float[Array, "e p"]
    r"""$\sqrt\tau / h$ at every quadrature point."""
    derivative: Float[Array, "s t"]
    """A, the derivative of the least-squares affine map of the data."""


def tension_of(
    tau: float,
    jets: Jets,
    points: Float[Array, "Q s"],
    x: Float[Array, "k s"],
    y: Float[Array, "k t"],
    weights: Float[Array, " k"],
) -> Tension | None:
    """h is the spacing of the data around each point. None if `tau` is zero."""
    if tau == 0:
        return None
    h = data_spacings(np.asarray(points), np.asarray(x))
    share = np.asarray(weights / jnp.sum(weights))[:, None]
    centre = lambda a: np.sqrt(share) * (a - np.sum(share * a, axis=0))
    derivative = np.linalg.lstsq(centre(x), centre(y), rcond=THIN)[0]
    return Tension(jnp.sqrt(tau) / h[jets.index], jnp.asarray(derivative))
