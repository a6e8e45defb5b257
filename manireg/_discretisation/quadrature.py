"""Points on a source manifold with frames and weights: grids in a chart, quasi-uniform
points, points of a cloud."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float
from scipy.spatial import KDTree
from scipy.stats import qmc

from .._sources.charts import Chart
from .._sources.sources import Source
from ..manifolds import AbstractManifold, PointCloud, Sphere
from ..manifolds._defaults.frames import tangent_frames
from ..manifolds._scans.cloud_fits import triangle_areas
from .spacing import (
    data_spacings,
    equally_near,
    farthest_indices,
    farthest_points,
)

Sample = tuple[
    Float[ArrayLike, "Q s"], Float[ArrayLike, "Q s m"], Float[ArrayLike, " Q"]
]
"""Points, frames, quadrature weights."""

CANDIDATES = 12  # random points per point wanted, of which farthest ones are taken
TANGENT_SAMPLES = 256  # points per Voronoi cell volume


def axis_counts(chart: Chart, n: int) -> list[int]:
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


def gauss_panels(a: float, b: float, panels: int, nodes: int):
    x, w = np.polynomial.legendre.leggauss(nodes)
    edges = np.linspace(a, b, panels + 1)
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half * (1 + x)).ravel(), (half * w).ravel()


def grid(chart: Chart, axes) -> Sample:
    """The product of rules `(nodes, weights)` along the axes of a chart."""
    coordinates = np.stack(np.meshgrid(*(x for x, _ in axes), indexing="ij"), -1)
    weights = functools.reduce(np.multiply.outer, (w for _, w in axes)).ravel()
    u = jnp.asarray(coordinates.reshape(len(weights), -1))
    points = jax.vmap(chart.embed)(u)
    jacobian = jax.vmap(jax.jacfwd(chart.embed))(u)
    frames, triangle = jnp.linalg.qr(jacobian)
    volume = jnp.abs(jnp.prod(jnp.diagonal(triangle, axis1=-2, axis2=-1), axis=-1))
    return points, frames, volume * weights


def quasi_uniform(source: Source, n: int, with_weights: bool) -> Sample:
    """The Fibonacci lattice on S^2; elsewhere farthest points of random ones, if wanted
    with the volumes of their Voronoi cells."""
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
        cloud = source.random_points(jax.random.key(0), CANDIDATES * n)
        points = farthest_points(np.asarray(cloud).reshape(CANDIDATES * n, -1), n)
        frames = tangent_frames(source, points)
        weights = np.ones(n)
        if with_weights:
            weights = voronoi_volumes(source, points, frames)
    return points, frames, weights


def of_cloud(source: PointCloud, n: int, around, graded: bool) -> Sample:
    """`n` points of the cloud, farthest points from those next to `around` (if they are
    no more than `n`); the area of every point of the cloud goes to the nearest of them.
    Where a mesh has fewer vertices, the same of points in its triangles."""
    points, areas = np.asarray(source.points), np.asarray(source.areas)
    if n > len(points) and source.triangles is not None:
        points, areas = _in_triangles(source, n)
    first, spacing = [], 1.0
    if around is not None:
        near, equal = equally_near(points, np.asarray(around))
        first = np.unique(np.min(np.where(equal, near, len(points)), axis=1))
    if len(first) > n:
        first = []
    if graded:
        spacing = data_spacings(points, np.asarray(around))
    index = farthest_indices(points, min(n, len(points)), first, spacing)
    index = index[np.sort(np.unique(index, return_index=True)[1])]
    local_lam = spacing ** (4 - source.dim)
    areas = areas * local_lam * np.sum(areas) / np.sum(areas * local_lam)
    weights = _shared_out(points, areas, points[index])
    chosen = jnp.asarray(points[index])
    if len(points) != len(source.points):
        chosen = source.project(chosen)
    return chosen, tangent_frames(source, chosen), weights


def _in_triangles(source: PointCloud, n: int) -> tuple[np.ndarray, np.ndarray]:
    """At least `n` points in the triangles, each cut into equal ones, and the areas of
    these. Their sum is that of the cloud. The points are a little beside the centroids,
    which several vertices may be nearest to: rounding would choose the patch."""
    corners = np.asarray(source.points)[np.asarray(source.triangles)]
    cuts = int(np.ceil(np.sqrt(n / len(corners))))
    i, j = np.indices((cuts, cuts)).reshape(2, -1)
    upright, upturned = i + j < cuts, i + j < cuts - 1
    u, v = (
        np.concatenate([a[upright] + 1 / 3, a[upturned] + 2 / 3]) + beside
        for a, beside in ((i, 0.02), (j, -0.005))
    )
    u, v = u / cuts, v / cuts
    share = np.stack([1 - u - v, u, v], axis=1)
    points = np.einsum("qc,tcs->tqs", share, corners).reshape(-1, 3)
    areas = np.repeat(triangle_areas(corners), len(share))
    return points, areas * np.sum(np.asarray(source.areas)) / np.sum(areas)


def _shared_out(points, areas, owners) -> np.ndarray:
    """The area of each point goes to the nearest owner; owners equally near share it."""
    near, equal = equally_near(owners, points)
    share = equal / np.sum(equal, axis=1, keepdims=True) * areas[:, None]
    return np.bincount(near.ravel(), share.ravel(), minlength=len(owners))


def _fibonacci(n: int) -> np.ndarray:
    i = np.arange(n) + 0.5
    z, longitude = 1 - 2 * i / n, np.pi * (1 + 5**0.5) * i
    rho = np.sqrt(1 - z**2)
    return np.stack([rho * np.cos(longitude), rho * np.sin(longitude), z], axis=1)


def voronoi_volumes(source, points, frames) -> np.ndarray:
    """Volume of each point's Voronoi cell on M. Quasi-random vectors u of a tangent ball
    are sent to M by u -> pi(p + E u); those that stay nearest to p count, each with the
    volume distortion of that map."""
    m = source.dim
    tree = KDTree(points)
    neighbours = min(len(points), 2 * m + 2)
    radius = tree.query(points, k=neighbours)[0][:, -1]
    ball = qmc.Sobol(m, rng=0).random(4 * TANGENT_SAMPLES) * 2 - 1
    ball = ball[np.sum(ball**2, axis=1) < 1]
    ball_volume = 2.0**m * len(ball) / (4 * TANGENT_SAMPLES)
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
