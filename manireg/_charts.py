"""Sources that are the image of a box of coordinates, some of them periodic: they get
product quadrature. Other sources do without (`_domain`)."""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ._frames import tangent_frames
from ._sources import Box, Interval
from .manifolds import (
    Cylinder,
    Euclidean,
    FlatTorus,
    Sphere,
    SymmetricPositiveDefinite,
    Torus,
)


class Chart(NamedTuple):
    """u -> embed(u) on a box of coordinates, some of them periodic."""

    lower: np.ndarray
    upper: np.ndarray
    periodic: tuple[bool, ...]
    embed: Callable[[Array], Array]


@functools.singledispatch
def chart_of(source, around) -> Chart | None:
    """Chart of `source`, or None. `around`: data `(k, s)` that an unbounded source is cut
    to. A new chart registers here."""
    return None


@chart_of.register(Interval)
@chart_of.register(Box)
def _(source, around):
    low, high = source.bounds
    return Chart(low, high, (False,) * source.dim, lambda u: u)


@chart_of.register
def _(source: Euclidean, around):
    low, high = _extent(source, around)
    return Chart(low, high, (False,) * source.dim, lambda u: u)


@chart_of.register
def _(source: SymmetricPositiveDefinite, around):
    """Flat: orthonormal coordinates of the linear span, cut to the data."""
    basis = tangent_frames(source, np.zeros((1, np.prod(source.point_shape))))[0]
    low, high = _extent(source, None if around is None else around @ basis)
    return Chart(low, high, (False,) * source.dim, lambda u: jnp.asarray(basis) @ u)


@chart_of.register
def _(source: FlatTorus, around):
    radii = jnp.broadcast_to(jnp.asarray(source.radii), (source.dim,))

    def embed(u):
        circles = radii * jnp.stack([jnp.cos(u), jnp.sin(u)])
        return circles.T.ravel()

    turn = np.full(source.dim, 2 * np.pi)
    return Chart(0 * turn, turn, (True,) * source.dim, embed)


@chart_of.register
def _(source: Cylinder, around):
    low, high = _extent(source, None if around is None else around[:, 2:])
    low, high = np.append(0.0, low), np.append(2 * np.pi, high)

    def embed(u):
        return jnp.array(
            [source.radius * jnp.cos(u[0]), source.radius * jnp.sin(u[0]), u[1]]
        )

    return Chart(low, high, (True, False), embed)


@chart_of.register
def _(source: Torus, around):
    def embed(u):
        rho = source.R + source.r * jnp.cos(u[1])
        return jnp.array(
            [rho * jnp.cos(u[0]), rho * jnp.sin(u[0]), source.r * jnp.sin(u[1])]
        )

    turn = np.full(2, 2 * np.pi)
    return Chart(0 * turn, turn, (True, True), embed)


@chart_of.register
def _(source: Sphere, around):
    if source.dim != 1:
        return None

    def circle(u):
        return jnp.stack([jnp.cos(u[0]), jnp.sin(u[0])]) * source.radius

    return Chart(np.zeros(1), np.array([2 * np.pi]), (True,), circle)


def _extent(source, coordinates):
    """Bounding box of the data, for a source that is not bounded by itself."""
    if coordinates is None:
        raise ValueError(
            f"{type(source).__name__} is unbounded as a source: pass `around`, the data "
            "points whose bounding box is to be covered."
        )
    coordinates = np.asarray(coordinates)
    lower, upper = coordinates.min(axis=0), coordinates.max(axis=0)
    if not np.all(lower < upper):
        raise ValueError(
            f"{type(source).__name__} as a source is cut to the bounding box of `x`, "
            f"which is empty: all points agree in a coordinate ({lower} to {upper})."
        )
    return lower, upper
