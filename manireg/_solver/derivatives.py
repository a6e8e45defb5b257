r"""Derivatives of a fitted map: jets of Psi are linear in the coefficients, and those of
$\Phi = \pi \circ \Psi$ functions of the jet.

Functions of one point: to be called through `evaluation.at_covered`."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._discretisation.local_polynomials import LocalPolynomials, basis_values
from .._source import AbstractSource
from ..manifolds import AbstractManifold
from ..manifolds._defaults.covariant_derivative import derivatives_along
from .directions import along_curve, frame_at
from .evaluation import nearby


class Differential(NamedTuple):
    """Of a map, at one point or several."""

    derivatives: Float[Array, "..."]
    """`(n, *target.point_shape, m)`: along the columns of the frame."""
    frame: Float[Array, "..."]
    """`(n, s, m)`: orthonormal, of the tangent space of the source."""


def check_curve(source: AbstractSource, name: str):
    if source.dim != 1:
        raise ValueError(
            f"{name}: only along sources of dimension 1, found {type(source).__name__} of "
            f"dimension {source.dim}; take `differential`, the derivatives along a frame."
        )


def curve_jet(
    basis: LocalPolynomials,
    source: AbstractSource | None,
    x: Float[Array, " s"],
    near: Int[Array, " L"],
    order: int,
) -> Float[Array, "J LC"]:
    """From the coefficients of the centres `near` to Psi, Psi', ..., up to that order,
    along a source of dimension 1 (`curved`), per unit of x as users write it."""
    values = lambda x: basis_values(basis, x, near)
    return jnp.stack(derivatives_along(values, order)(*along_curve(source, x, order)))


def frame_jet(
    basis: LocalPolynomials,
    frame: Float[Array, "s m"],
    x: Float[Array, " s"],
    near: Int[Array, " L"],
) -> Float[Array, "J LC"]:
    """From the coefficients to Psi and its derivatives along the m columns of a frame."""
    values = lambda x: basis_values(basis, x, near)
    along = lambda e: jax.jvp(values, (x,), (e,))
    value, derivatives = jax.vmap(along, in_axes=1, out_axes=(None, 0))(frame)
    return jnp.concatenate([value[None], derivatives])


def tangent_of_curve(
    target: AbstractManifold, jet: Float[Array, "J t"]
) -> Float[Array, "..."]:
    r"""$(D/dx)^{J-2} (\pi \circ \psi)'$ of a curve psi with this jet: the velocity from
    two rows, the acceleration from three."""
    psi = [row.reshape(target.point_shape) for row in jet]
    coordinates = target.covariant_derivative(psi)
    return target.from_orthonormal(target.project(psi[0]), coordinates)


def tangents_of_frame(
    target: AbstractManifold, jet: Float[Array, "J t"]
) -> Float[Array, "... m"]:
    r"""$d(\pi \circ \Psi)$ along a frame of m = J - 1 vectors."""
    velocity = lambda row: tangent_of_curve(target, jnp.stack([jet[0], row]))
    return jax.vmap(velocity, out_axes=-1)(jet[1:])


def velocity_at(owner: Any, x, near):
    return _of_curve(owner, x, near, order=1)


def acceleration_at(owner: Any, x, near):
    return _of_curve(owner, x, near, order=2)


def _of_curve(owner, x, near, order: int):
    basis, (source, target, w, origin) = owner
    jet = curve_jet(basis, source, x, near, order)
    return tangent_of_curve(target, of_psi(jet, nearby(basis, w, near), origin))


def differential_at(owner: Any, x, near):
    basis, (source, target, w, origin) = owner
    frame = frame_at(source, x)
    jet = of_psi(frame_jet(basis, frame, x, near), nearby(basis, w, near), origin)
    return Differential(tangents_of_frame(target, jet), frame)


def of_psi(
    jet: Float[Array, "J LC"], w: Float[Array, "LC t"], origin: Float[Array, " t"]
) -> Float[Array, "J t"]:
    """The jet of Psi = origin + what the coefficients say."""
    return (jet @ w).at[0].add(origin)
