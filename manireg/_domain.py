"""Source manifold -> points with frames, second fundamental forms and weights.

`Domain` is the hinge of the library: quadrature points and centres of the basis are both
Domains, and whatever can produce one (an interval, a box, a sphere, a scanned surface)
can be the source of a regression.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial import cKDTree
from scipy.stats import qmc

from .manifolds import (
    AbstractManifold,
    Cylinder,
    Euclidean,
    FlatTorus,
    Product,
    Sphere,
    SymmetricPositiveDefinite,
    Torus,
)


class Domain(eqx.Module):
    """A source manifold M^m in R^s, sampled at Q points."""

    points: Float[Array, "Q s"]
    """Ambient coordinates."""
    frames: Float[Array, "Q s m"]
    """Orthonormal columns spanning the tangent space."""
    second_forms: Float[Array, "Q m m s"]
    """II(E_a, E_b), a normal vector, for each pair of frame vectors."""
    weights: Float[Array, " Q"]
    """Quadrature weights: sum_q weights_q f(points_q) approximates the integral dvol."""

    @property
    def dim(self) -> int:
        return self.frames.shape[-1]


class Box(eqx.Module):
    r"""The box $\prod_a [lower_a, upper_a] \subset \mathbb{R}^m$ as a source.

    **Arguments:** `lower`, `upper`: sequences of m numbers, lower < upper.
    Points are arrays `(..., m)`.
    """

    lower: tuple[float, ...] = eqx.field(static=True, converter=lambda v: _floats(v))
    upper: tuple[float, ...] = eqx.field(static=True, converter=lambda v: _floats(v))

    def __check_init__(self):
        if len(self.lower) != len(self.upper):
            raise ValueError(
                "Box: `lower` and `upper` must have the same length, found "
                f"{len(self.lower)} and {len(self.upper)}."
            )
        _check_bounds("Box", self.lower, self.upper)

    @property
    def dim(self) -> int:
        return len(self.lower)

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.dim,)


class Interval(eqx.Module):
    """The interval [a, b] as a source. Points are arrays `(...,)`: plain numbers."""

    a: float = eqx.field(static=True, converter=float)
    b: float = eqx.field(static=True, converter=float)

    def __check_init__(self):
        _check_bounds("Interval", (self.a,), (self.b,))

    @property
    def dim(self) -> int:
        return 1

    @property
    def point_shape(self) -> tuple[int, ...]:
        return ()


Source = AbstractManifold | Box | Interval


def _floats(values) -> tuple[float, ...]:
    return tuple(float(v) for v in np.atleast_1d(np.asarray(values, dtype=float)))


def _check_bounds(name, lower, upper):
    if not (np.all(np.isfinite(lower)) and np.all(np.isfinite(upper))):
        raise ValueError(f"{name}: bounds must be finite, found {lower} and {upper}.")
    if not np.all(np.asarray(lower) < np.asarray(upper)):
        raise ValueError(
            f"{name}: the lower bound must be below the upper one, found {lower} and "
            f"{upper}."
        )


# -- charts: sources that are the image of a product of intervals and circles ----------


class _Chart(NamedTuple):
    """u -> embed(u) on a box of coordinates, some of them periodic."""

    lower: np.ndarray
    upper: np.ndarray
    periodic: tuple[bool, ...]
    embed: Callable[[Array], Array]


@functools.singledispatch
def _chart(source, around) -> _Chart | None:
    return None


@_chart.register
def _(source: Interval, around):
    return _Chart(np.array([source.a]), np.array([source.b]), (False,), lambda u: u)


@_chart.register
def _(source: Box, around):
    bounds = np.array(source.lower), np.array(source.upper)
    return _Chart(*bounds, (False,) * source.dim, lambda u: u)


@_chart.register
def _(source: Euclidean, around):
    return _Chart(*_extent(source, around), (False,) * source.dim, lambda u: u)


@_chart.register
def _(source: SymmetricPositiveDefinite, around):
    """Flat: orthonormal coordinates of the linear span, cut to the data."""
    basis = tangent_frames(source, np.zeros((1, np.prod(source.point_shape))))[0]
    bounds = _extent(source, None if around is None else around @ basis)
    return _Chart(*bounds, (False,) * source.dim, lambda u: jnp.asarray(basis) @ u)


@_chart.register
def _(source: FlatTorus, around):
    radii = jnp.broadcast_to(jnp.asarray(source.radii), (source.dim,))

    def embed(u):
        circles = radii * jnp.stack([jnp.cos(u), jnp.sin(u)])
        return circles.T.ravel()

    turn = np.full(source.dim, 2 * np.pi)
    return _Chart(0 * turn, turn, (True,) * source.dim, embed)


@_chart.register
def _(source: Cylinder, around):
    height = None if around is None else around[:, 2:]
    low, high = (np.append(end, z) for end, z in zip((0.0, 2 * np.pi), _extent(source, height)))

    def embed(u):
        return jnp.array(
            [source.radius * jnp.cos(u[0]), source.radius * jnp.sin(u[0]), u[1]]
        )

    return _Chart(low, high, (True, False), embed)


@_chart.register
def _(source: Torus, around):
    def embed(u):
        rho = source.R + source.r * jnp.cos(u[1])
        return jnp.array(
            [rho * jnp.cos(u[0]), rho * jnp.sin(u[0]), source.r * jnp.sin(u[1])]
        )

    turn = np.full(2, 2 * np.pi)
    return _Chart(0 * turn, turn, (True, True), embed)


@_chart.register
def _(source: Sphere, around):
    if source.dim != 1:
        return None
    circle = lambda u: source.radius * jnp.array([jnp.cos(u[0]), jnp.sin(u[0])])
    return _Chart(np.zeros(1), np.array([2 * np.pi]), (True,), circle)


def _extent(source, coordinates):
    """Bounding box of the data, for a source that is not bounded by itself."""
    if coordinates is None:
        raise ValueError(
            f"{type(source).__name__} is unbounded as a source: pass `around`, the data "
            "points whose bounding box is to be covered."
        )
    lower, upper = coordinates.min(axis=0), coordinates.max(axis=0)
    if not np.all(lower < upper):
        raise ValueError(
            f"{type(source).__name__} as a source is cut to the bounding box of `x`, "
            f"which is empty: all points agree in a coordinate ({lower} to {upper})."
        )
    return lower, upper


# -- discretisation ------------------------------------------------------------------

_NODES_PER_SPACING = {1: 10, 2: 4}  # Gauss nodes a centre and axis; 3 from dimension 3
_CLOUD = 12  # random points of the cloud per quadrature point
_TANGENT_SAMPLES = 256  # points per Voronoi cell volume


def centres_of(source: Source, n: int, around=None) -> Domain:
    """About `n` quasi-uniform points of `source`, boundary included, as basis centres.
    The weights are not meant for integration. Arguments as for `discretise`."""
    chart = _chart(source, around)
    if chart is not None:
        spacings = _axis_counts(chart, n)
        axes = []
        for low, high, periodic, count in zip(
            chart.lower, chart.upper, chart.periodic, spacings
        ):
            nodes = np.linspace(low, high, count + 1)
            axes.append((nodes[:-1] if periodic else nodes, np.ones(count + 1 - periodic)))
        return _grid(source, chart, axes)
    if isinstance(source, Product):
        return _product_domain(source, n, around, centres_of)
    return _quasi_uniform(source, n, with_weights=False)


def discretise(source: Source, n: int, around=None) -> Domain:
    """Quadrature for a basis of about `n` centres: 10 points a centre on curves, 16 on
    surfaces, 27 in dimension 3 (fewer hides stiff modes of the energy).

    **Arguments:**

    - `source`: an `Interval`, a `Box` or any manifold.
    - `n`: the number of centres of the basis.
    - `around`: data points (flattened). Unbounded sources (Euclidean space, cylinder,
      SPD matrices) are cut to the box that holds them, which is then required.

    Sources with a global chart use composite Gauss-Legendre rules (trapezoid rule along
    periodic coordinates), S^2 the Fibonacci lattice, products the product rule. Every
    other manifold takes farthest points of a cloud of `random_points`, weighted by the
    volume of their Voronoi cells, measured in the tangent space.
    """
    per_axis = _NODES_PER_SPACING.get(source.dim, 3)
    chart = _chart(source, around)
    if chart is not None:
        axes = []
        for low, high, periodic, count in zip(
            chart.lower, chart.upper, chart.periodic, _axis_counts(chart, n)
        ):
            if periodic:
                nodes = np.linspace(low, high, count * per_axis + 1)[:-1]
                axes.append((nodes, np.full(len(nodes), (high - low) / len(nodes))))
            else:
                # two panels a spacing: the kernel's joints fall on panel ends
                panels, nodes = (2, per_axis // 2) if per_axis % 2 == 0 else (1, per_axis)
                axes.append(_gauss_panels(low, high, count * panels, nodes))
        return _grid(source, chart, axes)
    if isinstance(source, Product):
        return _product_domain(source, n, around, discretise)
    return _quasi_uniform(source, n * per_axis**source.dim, with_weights=True)


def _axis_counts(chart: _Chart, n: int) -> list[int]:
    """Spacings along each axis so that cells are about cubes and `n` in number."""
    steps = np.linspace(0, 1, 65)[:, None] * (chart.upper - chart.lower)
    middle = 0.5 * (chart.lower + chart.upper)
    lengths = []
    for axis in range(len(middle)):
        line = np.tile(middle, (len(steps), 1))
        line[:, axis] = chart.lower[axis] + steps[:, axis]
        points = np.asarray(jax.vmap(chart.embed)(jnp.asarray(line)))
        lengths.append(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    spacing = (np.prod(lengths) / n) ** (1 / len(lengths))
    return [max(1 if not p else 3, round(l / spacing)) for l, p in zip(lengths, chart.periodic)]


def _gauss_panels(a: float, b: float, panels: int, nodes: int):
    x, w = np.polynomial.legendre.leggauss(nodes)
    edges = np.linspace(a, b, panels + 1)
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half * (1 + x)).ravel(), (half * w).ravel()


def _grid(source: Source, chart: _Chart, axes) -> Domain:
    coordinates = np.stack(np.meshgrid(*(x for x, _ in axes), indexing="ij"), -1)
    weights = functools.reduce(np.multiply.outer, (w for _, w in axes)).ravel()
    u = jnp.asarray(coordinates.reshape(len(weights), -1))
    points = jax.vmap(chart.embed)(u)
    jacobian = jax.vmap(jax.jacfwd(chart.embed))(u)
    frames, triangle = jnp.linalg.qr(jacobian)
    volume = jnp.abs(jnp.prod(jnp.diagonal(triangle, axis1=-2, axis2=-1), axis=-1))
    return _with_second_forms(source, points, frames, volume * weights)


def _product_domain(source: Product, n: int, around, build) -> Domain:
    """Product rule: n is shared out so that all factors get about the same spacing."""
    parts = (None,) * len(source.factors) if around is None else source.split(around)
    counts = [max(4, round(n ** (f.dim / source.dim))) for f in source.factors]
    domains = [
        build(f, c, None if x is None else np.asarray(x).reshape(len(x), -1))
        for f, c, x in zip(source.factors, counts, parts)
    ]
    index = np.stack(
        np.meshgrid(*(np.arange(len(d.points)) for d in domains), indexing="ij"), -1
    ).reshape(-1, len(domains))
    picked = [jax.tree.map(lambda a, i=i: a[index[:, i]], d) for i, d in enumerate(domains)]
    frames = jax.vmap(jax.scipy.linalg.block_diag)(*(d.frames for d in picked))
    points = jnp.concatenate([d.points for d in picked], axis=1)
    weights = functools.reduce(jnp.multiply, (d.weights for d in picked))
    return _with_second_forms(source, points, frames, weights)


def _quasi_uniform(source: AbstractManifold, n: int, with_weights: bool) -> Domain:
    if isinstance(source, Sphere) and source.dim == 2:
        points = float(source.radius) * _fibonacci(n)
        weights = np.full(n, 4 * np.pi * float(source.radius) ** 2 / n)
        frames = tangent_frames(source, points)
    else:
        cloud = source.random_points(jax.random.key(0), _CLOUD * n)
        points = farthest_points(np.asarray(cloud).reshape(_CLOUD * n, -1), n)
        frames = tangent_frames(source, points)
        weights = np.ones(n)
        if with_weights:
            weights = _voronoi_volumes(source, points, frames)
    return _with_second_forms(source, points, frames, weights)


def _fibonacci(n: int) -> np.ndarray:
    i = np.arange(n) + 0.5
    z, longitude = 1 - 2 * i / n, np.pi * (1 + 5**0.5) * i
    rho = np.sqrt(1 - z**2)
    return np.stack([rho * np.cos(longitude), rho * np.sin(longitude), z], axis=1)


def farthest_points(cloud: np.ndarray, n: int) -> np.ndarray:
    """`n` points of `cloud`, each the farthest from those before it."""
    chosen = np.zeros(n, dtype=int)
    distance = np.full(len(cloud), np.inf)
    for i in range(1, n):
        step = np.sum((cloud - cloud[chosen[i - 1]]) ** 2, axis=1)
        distance = np.minimum(distance, step)
        chosen[i] = np.argmax(distance)
    return cloud[chosen]


def _voronoi_volumes(source, points, frames) -> np.ndarray:
    """Volume of each point's Voronoi cell on M. Quasi-random vectors u of a tangent ball
    are sent to M by u -> pi(p + E u); those that stay nearest to p count, each with the
    volume distortion of that map."""
    m = source.dim
    tree = cKDTree(points)
    neighbours = min(len(points), 2 * m + 2)
    radius = tree.query(points, k=neighbours)[0][:, -1]
    ball = qmc.Sobol(m, rng=0).random(4 * _TANGENT_SAMPLES) * 2 - 1
    ball = ball[np.sum(ball**2, axis=1) < 1]
    ball_volume = 2.0**m * len(ball) / (4 * _TANGENT_SAMPLES)
    shape = source.point_shape

    def to_manifold(p, frame, u):
        return source.project((p + frame @ u).reshape(shape)).ravel()

    def cell(p, frame, r):
        u = r * jnp.asarray(ball)
        landed = jax.vmap(lambda u: to_manifold(p, frame, u))(u)
        jacobian = jax.vmap(jax.jacfwd(lambda u: to_manifold(p, frame, u)))(u)
        gram = jnp.einsum("usa,usb->uab", jacobian, jacobian)
        return landed, jnp.sqrt(jnp.linalg.det(gram)) * r**m

    batched = jax.jit(jax.vmap(cell))
    landed, volume = batched(*map(jnp.asarray, (points, frames, radius)))
    nearest = tree.query(np.asarray(landed).reshape(-1, points.shape[1]))[1]
    own = nearest.reshape(len(points), -1) == np.arange(len(points))[:, None]
    return np.sum(own * np.asarray(volume), axis=1) * ball_volume / len(ball)


def tangent_frames(source: AbstractManifold, points) -> np.ndarray:
    """Orthonormal frames (Q, s, m) of the tangent spaces, from the tangent projections."""
    s = points.shape[1]
    axes = jnp.eye(s).reshape(s, *source.point_shape)
    project = lambda p: jax.vmap(lambda v: source.tangent_projection(p, v))(axes)
    batch = jnp.asarray(points).reshape(-1, *source.point_shape)
    projectors = np.asarray(jax.vmap(project)(batch)).reshape(-1, s, s)
    symmetric = 0.5 * (projectors + projectors.transpose(0, 2, 1))
    return np.linalg.eigh(symmetric)[1][:, :, -source.dim :]


def complete_frames(frames: Float[Array, "K s m"]) -> Float[Array, "K s s"]:
    """Tangent frames followed by an orthonormal basis of the normal space."""
    normals = jnp.linalg.qr(frames, mode="complete")[0][:, :, frames.shape[-1] :]
    return jnp.concatenate([frames, normals], axis=-1)


def _with_second_forms(source: Source, points, frames, weights) -> Domain:
    points, frames = jnp.asarray(points), jnp.asarray(frames)
    Q, s, m = frames.shape
    if isinstance(source, AbstractManifold):
        shape = source.point_shape

        def form(p, a, b):
            ambient = (v.reshape(shape) for v in (p, a, b))
            return source.second_fundamental_form(*ambient).ravel()

        over_b = jax.vmap(form, in_axes=(None, None, 1))
        over_ab = jax.vmap(over_b, in_axes=(None, 1, None))
        forms = jax.vmap(over_ab)(points, frames, frames)
    else:
        forms = jnp.zeros((Q, m, m, s))
    return Domain(points, frames, forms, jnp.asarray(weights))
