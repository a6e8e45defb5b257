"""What data ask of Psi, and the pull towards N that fixes what they do not see."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..manifolds import AbstractManifold
from .terms import AbstractTerm, Jet, project_flat


class GeodesicLoss(AbstractTerm):
    r"""$d_N(y, \pi(\Psi))^2$. Its model has the Jacobian of $\pi \circ \Psi$: exact for a
    perfect fit, and where N is positively curved never below the true Hessian."""

    name = "loss"
    place = "data"
    orders = (0,)

    def arguments(self, x, y):
        return y

    def residual(self, near: AbstractManifold, jet: Jet, args: Float[Array, " t"]):
        return project_flat(near, jet.value) - args

    def square(self, near: AbstractManifold, jet: Jet, args: Float[Array, " t"]):
        p = near.project(jet.value.reshape(near.point_shape))
        return near.squared_distance(p, args.reshape(near.point_shape))


class Pull(AbstractTerm):
    r"""$|\Psi - \pi(\Psi)|^2$: an energy of maps into N is blind to displacements of Psi
    normal to N."""

    name = "off_manifold"
    place = "quadrature"
    orders = (0,)

    def residual(self, near: AbstractManifold, jet: Jet, args):
        return jet.value - project_flat(near, jet.value)

    def factor(self, lam, gamma):
        return gamma


def largest_distance(gaps: Float[Array, "e p"], mask: Float[Array, "e p"]):
    """Of Psi to N, from squares."""
    largest = jnp.max(gaps * mask)
    apart = largest > 0  # the root has no derivative at 0, where flat targets are
    return jnp.where(apart, jnp.sqrt(jnp.where(apart, largest, 1.0)), 0.0)
