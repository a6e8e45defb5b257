"""Sources that are the image of a box of coordinates, some of them periodic: they get
product quadrature. Other sources do without (`_domain`)."""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..manifolds import (
    Cylinder,
    Euclidean,
    FlatTorus,
    Product,
    Sphere,
    SymmetricPositiveDefinite,
    Torus,
)
from ..manifolds._defaults.frames import tangent_frames
from .sources import Box, Interval


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


class Atlas(NamedTuple):
    """Charts that share one formula: u, label -> embed(u, label), on F boxes that together
    cover the source once."""

    lower: np.ndarray
    """`(F, m)`, as `upper`."""
    upper: np.ndarray
    labels: np.ndarray
    """`(F, l)`: what tells the charts apart."""
    embed: Callable[[Array, Array], Array]


def atlas_of(source, around) -> Atlas | None:
    """The chart of a source, the faces of a cube around a sphere, all pairs for a product;
    or None."""
    chart = chart_of(source, around)
    if chart is not None:
        embed = lambda u, label: chart.embed(u)
        return Atlas(chart.lower[None], chart.upper[None], np.zeros((1, 0)), embed)
    if isinstance(source, Sphere):
        return _cube(source)
    if isinstance(source, Product):
        return _product_atlas(source, around)
    return None


def _cube(sphere: Sphere) -> Atlas:
    """Equal angles along the axes of each face: tan u is the point on the face."""
    s = sphere.dim + 1
    turns = [np.roll(np.eye(s), i, axis=1) for i in range(s)]
    labels = np.stack([sign * turn.ravel() for turn in turns for sign in (1.0, -1.0)])

    def embed(u, label):
        on_face = jnp.append(1.0, jnp.tan(u)) @ label.reshape(s, s)
        return sphere.radius * on_face / jnp.sqrt(jnp.sum(on_face**2))

    corner = np.full((2 * s, sphere.dim), np.pi / 4)
    return Atlas(-corner, corner, labels, embed)


def _product_atlas(source: Product, around) -> Atlas | None:
    parts = (None,) * len(source.factors) if around is None else source.split(around)
    atlases = []
    for factor, x in zip(source.factors, parts):
        x = None if x is None else np.asarray(x).reshape(len(x), -1)
        atlases.append(atlas_of(factor, x))
    if any(atlas is None for atlas in atlases):
        return None
    picked = np.indices([len(a.lower) for a in atlases]).reshape(len(atlases), -1)
    join = lambda arrays: np.concatenate([a[i] for a, i in zip(arrays, picked)], axis=1)
    in_u = np.cumsum([a.lower.shape[1] for a in atlases])[:-1]
    in_label = np.cumsum([a.labels.shape[1] for a in atlases])[:-1]

    def embed(u, label):
        each = zip(atlases, jnp.split(u, in_u), jnp.split(label, in_label))
        return jnp.concatenate([a.embed(v, own) for a, v, own in each])

    lower, upper, labels = (
        join([getattr(a, name) for a in atlases])
        for name in ("lower", "upper", "labels")
    )
    return Atlas(lower, upper, labels, embed)
