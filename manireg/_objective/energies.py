"""Energies: what lambda multiplies, each with the discretisation it needs."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._discretisation.spacing import data_spacings
from .._discretisation.taylor import second_derivative_pairs as _pairs
from .._input.precision import as_scalar
from ..manifolds import AbstractManifold
from .terms import AbstractTerm, Jet, project_flat

THIN = 1e-2  # of the data's largest extent: across it the affine map is taken as 0


class AbstractEnergy(AbstractTerm):
    """A term of the integral over the source that smooths: of derivatives of order
    `order`, times lambda, whose unit is a length to the power of `2 order - m`."""

    place = "quadrature"
    order: ClassVar[int]
    gauge: ClassVar[float]
    """gamma vol(M) of solves in one stage."""
    on_target: ClassVar[bool]
    """Whether it is that of a map into N: then Newton starts on N."""
    degrees: ClassVar[tuple[int, int, int]]
    """Of the local polynomials, by default: on curves, surfaces, in dimension 3."""
    widths: ClassVar[tuple[float, float, float]]
    """Of their supports in spacings, by default, likewise."""

    def penalised(self) -> "AbstractEnergy":
        """The one to be minimised with gamma raised in stages (`method="penalty"`)."""
        return self

    def flat(
        self, m: int, args
    ) -> tuple[Float[Array, " J"], Float[ArrayLike, "#J #t"]]:
        """That of maps into a Euclidean space, the sum of c |row - b|^2 over the rows of
        a jet: all c and b."""
        return jnp.concatenate([jnp.zeros(1 + m), _counts(m)]), np.zeros((1, 1))

    def square(self, near: AbstractManifold, jet: Jet, args):
        """The sum of the squared lengths of the tangent vectors that `residual` holds, in
        the target's own metric."""
        p = jet.value.reshape(near.point_shape)
        vectors = self.residual(near, jet, args).reshape(-1, *near.point_shape)
        return jnp.sum(near.squared_norm(p, vectors))

    def factor(self, lam, gamma):
        return lam


class Eells(AbstractEnergy):
    r"""The Eells density of $\pi \circ \Psi$, a map into N:
    $P(D^2\pi[\partial_a\Psi, \partial_b\Psi] + D\pi\, H_{ab})$ (mathematics, 2.6 (ii)).
    Blind to displacements of Psi normal to N."""

    name = "eells"
    orders = (0, 1, 2)
    order = 2
    gauge = 0.1  # holds Psi near N, costs 1e-4 of E
    on_target = True
    degrees = 2, 2, 1
    widths = 2.5, 2.2, 1.5

    def residual(self, near: AbstractManifold, jet: Jet, args):
        value, first, second = jet
        push = lambda psi, v: jax.jvp(lambda p: project_flat(near, p), (psi,), (v,))[1]
        rows = []
        for (a, b), h in zip(_pairs(len(first)), second):
            rows.append(jax.jvp(push, (value, first[a]), (first[b], h))[1])
        return _multiplicities(len(first)) * _to_tangent(near, value, rows)

    def penalised(self):
        return PenalisedEells()


class PenalisedEells(AbstractEnergy):
    r"""$|P(\pi(\Psi)) H|^2$: the Eells density of the paper's (2), (5) for maps near N.
    The projector is that of the closest point, in any codimension."""

    name = "eells"
    orders = (0, 2)
    order = 2
    gauge = 0.1
    on_target = False
    degrees = 2, 2, 1
    widths = 2.5, 2.2, 1.5

    def residual(self, near: AbstractManifold, jet: Jet, args):
        return _bending(near, jet)


class AmbientEells(AbstractEnergy):
    """The same of a map of the whole neighbourhood of the source, which does not stay on N
    off it: in all directions of space, not of the projection, in one stage."""

    name = "eells"
    orders = (0, 2)
    order = 2
    gauge = 10.0
    on_target = False
    degrees = 1, 1, 1
    widths = 1.5, 1.5, 1.5

    def residual(self, near: AbstractManifold, jet: Jet, args):
        return _bending(near, jet)


class Tension(AbstractEnergy):
    r"""$|P H|^2 + \tau |P (D\Psi - A)|^2 / h^2$ in the neighbourhood of the source: what
    the first derivative costs, against A, that of the affine map of the data."""

    tau: Float[Array, ""] = eqx.field(converter=lambda v: as_scalar(v))
    derivative: Float[Array, "s t"]
    """A, of the least-squares affine map of the data."""
    data: Float[Array, "k s"]
    """Whose spacing around each point is h."""
    name = "eells"
    orders = (0, 1, 2)
    order = 2
    gauge = 10.0
    on_target = False
    degrees = 1, 1, 1
    widths = 1.5, 1.5, 1.5

    def arguments(self, x, y):
        return 1 / data_spacings(np.asarray(x), np.asarray(self.data))

    def residual(self, near: AbstractManifold, jet: Jet, args: Float[Array, ""]):
        stretching = [row - a for row, a in zip(jet.first, self.derivative)]
        strength = jnp.sqrt(self.tau) * args
        stretching = strength * _to_tangent(near, jet.value, stretching)
        return jnp.concatenate([_bending(near, jet), stretching])

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


def _bending(target: AbstractManifold, jet: Jet) -> Float[Array, "r t"]:
    m = round((np.sqrt(8 * len(jet.second) + 1) - 1) / 2)
    return _multiplicities(m) * _to_tangent(target, jet.value, jet.second)


def _to_tangent(target: AbstractManifold, psi, vectors) -> Float[Array, "r t"]:
    p = psi.reshape(target.point_shape)
    project = lambda v: target.tangent_projection(p, v.reshape(p.shape)).ravel()
    if len(vectors) == 1:  # of a curve: under vmap an exact Hessian takes a third more
        return project(vectors[0])[None]
    return jax.vmap(project)(jnp.stack(vectors))


def _multiplicities(m: int) -> Float[Array, "pairs 1"]:
    """What residuals are multiplied with: roots of `_counts`."""
    return jnp.asarray(np.sqrt(_counts(m)))[:, None]


def _counts(m: int) -> Float[np.ndarray, " pairs"]:
    """How often second derivatives count in |H|^2: twice off the diagonal."""
    return np.array([1.0 if a == b else 2.0 for a, b in _pairs(m)])
