"""Energies: what lambda multiplies, each with the discretisation it needs."""

import abc
import math
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._discretisation.partial_derivatives import multiplicities, partial_derivatives
from .._discretisation.spacing import data_spacings
from .._input.precision import as_scalar
from ..manifolds import AbstractManifold
from .covariant_derivatives import covariant_derivatives, roots
from .terms import AbstractTerm, Jet

# Degree and width by default. Above dimension three the middle of a cell of centres is
# farther from them.
BY_DIMENSION = (2, 2.5), (2, 2.2), (1, 1.5), (1, 2.0)
THIN = 1e-2  # of the data's largest extent: across it the affine map is taken as 0


class Resolution(NamedTuple):
    """Of the basis."""

    degree: int
    """Of the local polynomials."""
    width: float
    """Radius of their supports in spacings."""
    share: float
    """Of the centres that an energy of second order has."""


class AbstractEnergy(AbstractTerm):
    """A term of the integral over the source that smooths: of derivatives of order
    `order`, times lambda, whose unit is a length to the power of `2 order - m`."""

    place = "quadrature"
    gauge: ClassVar[float]
    """gamma vol(M) of solves in one stage."""
    on_target: ClassVar[bool]
    """Whether it is that of a map into N: then Newton starts on N."""

    if TYPE_CHECKING:
        # a type checker would take an `AbstractVar` for an argument of the constructor
        order: ClassVar[Any]
    else:
        order: eqx.AbstractVar[int]

    @property
    def name(self) -> str:
        return "eells" if self.order == 2 else f"order_{self.order}"

    def penalised(self) -> "AbstractEnergy":
        """The one to be minimised with gamma raised in stages (`method="penalty"`)."""
        return self

    @abc.abstractmethod
    def resolution(self, m: int) -> "Resolution":
        """What the basis is by default."""

    def flat(
        self, m: int, args
    ) -> tuple[Float[Array, " J"], Float[ArrayLike, "#J #t"]]:
        """That of maps into a Euclidean space, the sum of c |row - b|^2 over the rows of
        a jet: all c and b."""
        lower = len(partial_derivatives(m, self.order - 1))
        costs = np.append(np.zeros(lower), multiplicities(m, self.order))
        return jnp.asarray(costs), np.zeros((1, 1))

    def factor(self, lam, gamma):
        return lam


class IntrinsicEnergy(AbstractEnergy):
    r"""$|\mathrm{Sym}\, \nabla^{p-1} d(\pi \circ \Psi)|^2$ of a map into N: of order 1 the
    harmonic energy, 2 the Eells energy (mathematics, 2.6 (ii)), 3 and 4 smoother ones.
    Blind to displacements of Psi normal to N."""

    order: int = eqx.field(static=True, default=2)
    gauge = 0.1  # holds Psi near N, costs 1e-4 of E
    on_target = True

    @property
    def orders(self) -> tuple[int, ...]:
        return tuple(range(self.order + 1))

    def resolution(self, m: int) -> "Resolution":
        degree, width = BY_DIMENSION[min(m, len(BY_DIMENSION)) - 1]
        return _resolution(m, self.order, degree, width)

    def penalised(self):
        return AmbientEnergy(self.order)

    def residual(self, near: AbstractManifold, jet: Jet, args):
        return covariant_derivatives(near, jet, self.order)


class AmbientEnergy(AbstractEnergy):
    r"""$|P(\pi(\Psi)) D^p \Psi|^2$, of Psi, not of its projection: of maps of the whole
    neighbourhood of the source, which do not stay on N off it, in one stage; and, of
    order 2, what the paper's (2), (5) minimise with gamma raised in stages
    (`method="penalty"`). The projector is that of the closest point, in any
    codimension."""

    order: int = eqx.field(static=True, default=2)
    gauge = 10.0
    on_target = False

    @property
    def orders(self) -> tuple[int, ...]:
        return 0, self.order

    def resolution(self, m: int) -> "Resolution":
        return _resolution(m, self.order, 1, 1.5)

    def residual(self, near: AbstractManifold, jet: Jet, args):
        return _bending(near, jet, self.order)


class Tension(AbstractEnergy):
    r"""$|P H|^2 + \tau |P (D\Psi - A)|^2 / h^2$ in the neighbourhood of the source: what
    the first derivative costs, against A, that of the affine map of the data."""

    references = ("schweikert1966interpolation", "franke1985thin")

    tau: Float[Array, ""] = eqx.field(converter=lambda v: as_scalar(v))
    derivative: Float[Array, "s t"]
    """A, of the least-squares affine map of the data."""
    data: Float[Array, "k s"]
    """Whose spacing around each point is h."""
    orders = (0, 1, 2)
    order = 2
    gauge = 10.0
    on_target = False

    def resolution(self, m: int) -> "Resolution":
        return _resolution(m, self.order, 1, 1.5)

    def arguments(self, x, y):
        return 1 / data_spacings(np.asarray(x), np.asarray(self.data))

    def residual(self, near: AbstractManifold, jet: Jet, args: Float[Array, ""]):
        stretching = [row - a for row, a in zip(jet.first, self.derivative)]
        strength = jnp.sqrt(self.tau) * args
        stretching = strength * _to_tangent(near, jet.value, stretching)
        return jnp.concatenate([_bending(near, jet, 2), stretching])

    def flat(self, m, args):
        bending, _ = super().flat(m, args)
        stretching = jnp.full(m, self.tau * args**2)
        rest = jnp.zeros((len(bending) - 1 - m, self.derivative.shape[1]))
        wanted = jnp.concatenate([rest[:1], self.derivative, rest])
        return bending.at[1 : 1 + m].set(stretching), wanted


def affine_derivative(
    x: Float[Array, "k s"], y: Float[Array, "k t"], weights: Float[Array, " k"]
) -> Float[Array, "s t"]:
    """That of the affine map that fits the data best."""
    total = np.asarray(weights)
    share = (total / np.sum(total))[:, None]
    centre = lambda a: np.sqrt(share) * (a - np.sum(share * a, axis=0))
    x, y = (centre(np.asarray(a)) for a in (x, y))
    return jax.device_put(np.linalg.lstsq(x, y, rcond=THIN)[0])


def _resolution(m: int, order: int, degree: int, width: float) -> Resolution:
    """From the degree that serves an energy of second order: one that follows has that
    order at least (with less, its error does not fall with the spacing), in so many fewer
    centres that unknowns are as many."""
    higher = degree if order <= 2 else max(degree, order)
    functions = lambda degree: math.comb(m + degree, m)
    return Resolution(higher, width, functions(degree) / functions(higher))


def _bending(target: AbstractManifold, jet: Jet, order: int) -> Float[Array, "r t"]:
    m = len(jet.first)
    return roots(m, order) * _to_tangent(target, jet.value, jet[order])


def _to_tangent(target: AbstractManifold, psi, vectors) -> Float[Array, "r t"]:
    p = psi.reshape(target.point_shape)
    project = lambda v: target.tangent_projection(p, v.reshape(p.shape)).ravel()
    if len(vectors) == 1:  # of a curve: under vmap an exact Hessian takes a third more
        return project(vectors[0])[None]
    return jax.vmap(project)(jnp.stack(vectors))
