"""Source manifold -> points with frames, second fundamental forms and weights.

`Domain` is the hinge of the library: quadrature points and centres of the basis are both
Domains, and whatever can produce one (an interval, a box, a sphere, a scanned surface)
can be the source of a regression.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial import KDTree
from scipy.stats import qmc

from ._charts import Chart, chart_of
from ._farthest_points import farthest_indices, farthest_points, graded_spacing
from ._frames import tangent_frames
from ._sources import Ambient, Source, sampled
from .manifolds import AbstractManifold, PointCloud, Product, Sphere


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


_NODES_PER_SPACING = {1: 10, 2: 4}  # Gauss nodes a centre and axis; 3 from dimension 3
_ON_CLOUD = 12  # points of a cloud per centre
_CLOUD = 12  # random points of the cloud per quadrature point
_TANGENT_SAMPLES = 256  # points per Voronoi cell volume


def centres_of(source: Source, n: int, around=None, graded: bool = False) -> Domain:
    """About `n` quasi-uniform points of `source`, boundary included, as basis centres.
    The weights are not meant for integration. Arguments as for `discretise`."""
    _check_graded(source, around, graded)
    chart = chart_of(source, around)
    if chart is not None:
        spacings = _axis_counts(chart, n)
        axes = []
        for low, high, periodic, count in zip(
            chart.lower, chart.upper, chart.periodic, spacings
        ):
            nodes = np.linspace(low, high, count + 1)
            axes.append(
                (nodes[:-1] if periodic else nodes, np.ones(count + 1 - periodic))
            )
        return _grid(source, chart, axes)
    if isinstance(source, Product):
        return _product_domain(source, n, around, centres_of)
    if isinstance(source, Ambient):
        return _ambient(centres_of(source.manifold, n, around, graded))
    if isinstance(source, PointCloud):
        return _of_cloud(source, n, around, graded)
    return _quasi_uniform(source, n, with_weights=False)


def discretise(source: Source, n: int, around=None, graded: bool = False) -> Domain:
    """Quadrature for a basis of about `n` centres: 10 points a centre on curves, 16 on
    surfaces (12 on point clouds), 27 in dimension 3 (fewer hides stiff modes of the
    energy).

    **Arguments:**

    - `source`: an `Interval`, a `Box` or any manifold.
    - `n`: the number of centres of the basis.
    - `around`: data points (flattened). Unbounded sources (Euclidean space, cylinder,
      SPD matrices) are cut to the box that holds them, which is then required.
    - `graded`: points denser near `around`, weights in proportion to spacing^{4-m}, with
      the same sum; point clouds only.

    Point clouds give points of theirs and share out the areas; `Ambient` takes over what
    its manifold gives. Sources with a global chart use composite Gauss-Legendre rules
    (trapezoid rule along periodic coordinates), S^2 the Fibonacci lattice, products the
    product rule. Every other manifold takes farthest points of a cloud of
    `random_points`, weighted by the volume of their Voronoi cells, measured in the tangent
    space.
    """
    _check_graded(source, around, graded)
    per_axis = _NODES_PER_SPACING.get(source.dim, 3)
    chart = chart_of(source, around)
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
                panels, nodes = (
                    (2, per_axis // 2) if per_axis % 2 == 0 else (1, per_axis)
                )
                axes.append(_gauss_panels(low, high, count * panels, nodes))
        return _grid(source, chart, axes)
    if isinstance(source, Product):
        return _product_domain(source, n, around, discretise)
    if isinstance(source, Ambient):
        return _ambient(discretise(source.manifold, n, around, graded))
    if isinstance(source, PointCloud):
        return _of_cloud(source, n * _ON_CLOUD, around, graded)
    return _quasi_uniform(source, n * per_axis**source.dim, with_weights=True)


def _check_graded(source: Source, around, graded: bool) -> None:
    surface = sampled(source)
    if graded and not (isinstance(surface, PointCloud) and around is not None):
        raise ValueError(
            "graded: only for sources that are point clouds, and near data; found "
            f"{type(surface).__name__}. Leave it out."
        )


def _axis_counts(chart: Chart, n: int) -> list[int]:
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
    counts = [max(1, round(length / spacing)) for length in lengths]
    # a closed curve needs three centres to be covered
    return [max(3, n) if p else n for n, p in zip(counts, chart.periodic)]


def _gauss_panels(a: float, b: float, panels: int, nodes: int):
    x, w = np.polynomial.legendre.leggauss(nodes)
    edges = np.linspace(a, b, panels + 1)
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half * (1 + x)).ravel(), (half * w).ravel()


def _grid(source: Source, chart: Chart, axes) -> Domain:
    coordinates = np.stack(np.meshgrid(*(x for x, _ in axes), indexing="ij"), -1)
    weights = functools.reduce(np.multiply.outer, (w for _, w in axes)).ravel()
    u = jnp.asarray(coordinates.reshape(len(weights), -1))
    points = jax.vmap(chart.embed)(u)
    jacobian = jax.vmap(jax.jacfwd(chart.embed))(u)
    frames, triangle = jnp.linalg.qr(jacobian)
    volume = jnp.abs(jnp.prod(jnp.diagonal(triangle, axis1=-2, axis2=-1), axis=-1))
    return with_second_forms(source, points, frames, volume * weights)


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
    picked = [
        jax.tree.map(lambda a, i=i: a[index[:, i]], d) for i, d in enumerate(domains)
    ]
    frames = jax.vmap(jax.scipy.linalg.block_diag)(*(d.frames for d in picked))
    points = jnp.concatenate([d.points for d in picked], axis=1)
    weights = functools.reduce(jnp.multiply, (d.weights for d in picked))
    return with_second_forms(source, points, frames, weights)


def _quasi_uniform(source: Source, n: int, with_weights: bool) -> Domain:
    if not isinstance(source, AbstractManifold):
        raise TypeError(
            f"cannot discretise a {type(source).__name__}; use mr.Interval, mr.Box or a "
            "manifold as the source."
        )
    if isinstance(source, Sphere) and source.dim == 2:
        radius = np.asarray(source.radius)
        points = radius * _fibonacci(n)
        weights = np.full(n, 4 * np.pi * radius**2 / n)
        frames = tangent_frames(source, points)
    else:
        cloud = source.random_points(jax.random.key(0), _CLOUD * n)
        points = farthest_points(np.asarray(cloud).reshape(_CLOUD * n, -1), n)
        frames = tangent_frames(source, points)
        weights = np.ones(n)
        if with_weights:
            weights = _voronoi_volumes(source, points, frames)
    return with_second_forms(source, points, frames, weights)


def _of_cloud(source: PointCloud, n: int, around, graded: bool) -> Domain:
    """`n` points of the cloud, farthest points from those next to `around` (if they are
    no more than `n`); the area of every point of the cloud goes to the nearest of them."""
    cloud = np.asarray(source.points)
    first, spacing = [], 1.0
    if around is not None:
        first = np.unique(source.nearest(jnp.asarray(around)))
    if len(first) > n:
        first = []
    if graded:
        spacing = graded_spacing(cloud, np.asarray(around))
    index = farthest_indices(cloud, min(n, len(cloud)), first, spacing)
    nearest = KDTree(cloud[index]).query(cloud)[1]
    areas = np.asarray(source.areas)
    local_lam = spacing ** (4 - source.dim)
    areas = areas * local_lam * np.sum(areas) / np.sum(areas * local_lam)
    weights = np.bincount(nearest, areas, minlength=len(index))
    points = source.points[index]
    frames = tangent_frames(source, points)
    return with_second_forms(source, points, frames, weights)


def _ambient(domain: Domain) -> Domain:
    """The same points and weights, all directions, no curvature."""
    Q, s, _ = domain.frames.shape
    frames = jnp.broadcast_to(jnp.eye(s), (Q, s, s))
    return Domain(domain.points, frames, jnp.zeros((Q, s, s, s)), domain.weights)


def _fibonacci(n: int) -> np.ndarray:
    i = np.arange(n) + 0.5
    z, longitude = 1 - 2 * i / n, np.pi * (1 + 5**0.5) * i
    rho = np.sqrt(1 - z**2)
    return np.stack([rho * np.cos(longitude), rho * np.sin(longitude), z], axis=1)


def _voronoi_volumes(source, points, frames) -> np.ndarray:
    """Volume of each point's Voronoi cell on M. Quasi-random vectors u of a tangent ball
    are sent to M by u -> pi(p + E u); those that stay nearest to p count, each with the
    volume distortion of that map."""
    m = source.dim
    tree = KDTree(points)
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


def with_second_forms(source: Source, points, frames, weights) -> Domain:
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
