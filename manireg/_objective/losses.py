"""What data ask of Psi, and the pull towards N that fixes what they do not see."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._input.precision import as_scalar
from ..manifolds import AbstractManifold
from .robust import AbstractLoss, Squared
from .terms import AbstractTerm, Jet, project_flat


class AbstractMisfit(AbstractTerm):
    r"""$\rho$ of a residual at a datum: its arguments are y there and the datum's relative
    precision, 1 on average over the data."""

    name = "loss"
    place = "data"
    orders = (0,)

    if TYPE_CHECKING:
        # a type checker would take an `AbstractVar` for an argument of the constructor
        loss: Any
        scale: Any
    else:
        loss: eqx.AbstractVar[AbstractLoss]
        scale: eqx.AbstractVar[Float[Array, ""]]

    @property
    def squared(self) -> bool:
        """Whether it has no scale."""
        return isinstance(self.loss, Squared)

    def rho(self, s):
        """Of the loss, for residuals in units of `scale`."""
        return self.scale**2 * self.loss.rho(s / self.scale**2)


class GeodesicMisfit(AbstractMisfit):
    r"""$q\, d_N(y, \pi(\Psi))^2$, q the precision. Its model has the Jacobian of
    $\pi \circ \Psi$: exact for a perfect fit, and where N is positively curved never below
    the true Hessian."""

    loss: AbstractLoss = Squared()
    scale: Float[Array, ""] = eqx.field(converter=as_scalar, default=1.0)

    def residual(self, near: AbstractManifold, jet: Jet, args):
        y, precision = args
        p = project_flat(near, jet.value).reshape(near.point_shape)
        gap = near.residual(y.reshape(near.point_shape), p)
        return jnp.sqrt(precision) * gap.ravel()

    def square(self, near: AbstractManifold, jet: Jet, args):
        y, precision = args
        p = near.project(jet.value.reshape(near.point_shape))
        return precision * near.squared_distance(p, y.reshape(near.point_shape))


class WhitenedMisfit(AbstractMisfit):
    r"""$|F \log_y \pi(\Psi)|^2$ with $F^\top F$ the precision in $T_yN$, of data that are
    known better in some directions than in others."""

    loss: AbstractLoss = Squared()
    scale: Float[Array, ""] = eqx.field(converter=as_scalar, default=1.0)

    def residual(self, near: AbstractManifold, jet: Jet, args):
        y, factor = args
        y = y.reshape(near.point_shape)
        p = project_flat(near, jet.value).reshape(near.point_shape)
        return factor @ near.orthonormal(y, near.log(y, p)).ravel()


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
