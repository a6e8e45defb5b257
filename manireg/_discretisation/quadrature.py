"""Points on a source manifold with frames and weights: grids in a chart, quasi-uniform
points, points of a cloud."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike, Float
from scipy.spatial import KDTree
from scipy.stats import qmc

from .._programs.sizes import at_each
from .._source import Atlas, Chart, itself
from ..manifolds._defaults.frames import tangent_frames
from ..manifolds._membership import projected
from .geodesics import christoffel, geodesics_of_chart
from .spacing import (
    data_spacings,
    equally_near,
    farthest_indices,
    farthest_points,
)

Sample = tuple[
    Float[ArrayLike, "Q s"],
    Float[ArrayLike, "Q s m"],
    Float[ArrayLike, "Q m m s"],
    Float[ArrayLike, " Q"],
    Float[ArrayLike, "Q R s"] | None,
]
"""Of a `Domain`, on the host."""
FlatSample = tuple[
    Float[ArrayLike, "Q s"], Float[ArrayLike, "Q s m"], Float[ArrayLike, " Q"]
]
"""Points, frames, weights."""

CANDIDATES = 12  # random points per point wanted, of which farthest ones are taken
CELLS = 64  # measured at a time
TANGENT_SAMPLES = 256  # points per Voronoi cell volume


def axis_counts(chart: Chart, n: int) -> list[int]:
    """Spacings along each axis so that cells are about cubes and `n` in number."""
    if chart.embed is itself:
        lengths = chart.upper - chart.lower
        return _counts(chart, lengths.tolist(), n)
    steps = np.linspace(0, 1, 65)[:, None] * (chart.upper - chart.lower)
    middle = 0.5 * (chart.lower + chart.upper)
    lengths = []
    for axis in range(len(middle)):
        line = np.tile(middle, (len(steps), 1))
        line[:, axis] = chart.lower[axis] + steps[:, axis]
        points, *_ = at_each(to_second_order, chart.embed, line)
        lengths.append(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    return _counts(chart, lengths, n)


def _counts(chart: Chart, lengths: list[float], n: int) -> list[int]:
    spacing = (np.prod(lengths) / n) ** (1 / len(lengths))
    counts = [max(1, round(length / spacing)) for length in lengths]
    # a closed curve needs three centres to be covered
    return [max(3, n) if p else n for n, p in zip(counts, chart.periodic)]


def gauss_panels(a: float, b: float, panels: int, nodes: int):
    x, w = np.polynomial.legendre.leggauss(nodes)
    edges = np.linspace(a, b, panels + 1)
    half = 0.5 * np.diff(edges)[:, None]
    return (edges[:-1, None] + half * (1 + x)).ravel(), (half * w).ravel()


def grid(chart: Chart, axes, order: int = 2) -> Sample:
    """The product of rules `(nodes, weights)` along the axes of a chart."""
    coordinates = np.stack(np.meshgrid(*(x for x, _ in axes), indexing="ij"), -1)
    weights = functools.reduce(np.multiply.outer, (w for _, w in axes)).ravel()
    u = coordinates.reshape(len(weights), -1)
    if chart.embed is itself:
        return *_flat(u), weights, None
    points, frames, forms, volume, higher = in_charts(chart, order, u)
    return points, frames, forms, volume * weights, higher


def _flat(u: Float[np.ndarray, "Q m"]):
    Q, m = u.shape
    return u, np.tile(np.eye(m), (Q, 1, 1)), np.zeros((Q, m, m, m))


def to_second_order(embed, *u):
    """The point, and the derivatives in the first of `u`, the coordinates."""
    jacobian = jax.jacfwd(embed)
    return embed(*u), jacobian(*u), jax.jacfwd(jacobian)(*u)


def in_charts(chart: Chart | Atlas, order: int, *u: Float[np.ndarray, "Q _"]) -> Sample:
    """At coordinates, the first of `u`: points, frames E = D A, with D the derivative of
    a chart, second forms, the part of D^2[A_a, A_b] that geodesics have, volumes,
    |det A|^-1, and geodesics to that order."""
    points, jacobian, hessian = at_each(to_second_order, chart.embed, *u)
    frames, triangle = np.linalg.qr(jacobian)
    if chart.metric is not None:
        metric = at_each(_metric, chart.metric, *u)
        triangle = np.swapaxes(np.linalg.cholesky(metric), 1, 2)
    volume = np.abs(np.prod(np.diagonal(triangle, axis1=1, axis2=2), axis=1))
    if not np.all(volume > 1e-12 * np.max(volume)):
        raise ValueError(
            "source: the derivative of its chart is not of full rank everywhere: a pole, "
            "a tip, or a coordinate without effect. Cut that out of the chart."
        )
    inverse = np.linalg.inv(triangle)
    bend = np.einsum("qsij,qia,qjb->qabs", hessian, inverse, inverse)
    if chart.metric is None:
        along = np.einsum("qabs,qsc->qabc", bend, frames)
    else:
        frames = jacobian @ inverse
        along = at_each(christoffel, chart.metric, *u)
        along = np.einsum("qcde,qda,qeb->qabc", along, inverse, inverse)
        along = np.einsum("qabd,qcd->qabc", along, triangle)
    forms = bend - np.einsum("qabc,qsc->qabs", along, frames)
    higher = None
    if order > 2 and (np.any(hessian) or chart.metric is not None):
        higher = geodesics_of_chart(chart, order, inverse, *u)
    return points, frames, forms, volume, higher


def _metric(metric, *u):
    return metric(*u)


def quasi_uniform(source, n: int, with_weights: bool) -> FlatSample:
    """Evenly spread by a formula (on S^2), else farthest points of random ones, if wanted
    with the volumes of their Voronoi cells."""
    even = source.even_points(n)
    if even is not None:
        points, weights = even
        return points, tangent_frames(source, points), weights
    cloud = source.random_points(jax.random.key(0), CANDIDATES * n)
    points = farthest_points(np.asarray(source.to_ambient(cloud)), n)
    frames = tangent_frames(source, points)
    if with_weights:
        return points, frames, voronoi_volumes(source, points, frames)
    return points, frames, np.ones(n)


def of_known(
    source, known: tuple[np.ndarray, np.ndarray], n: int, around, graded: bool, order=2
) -> FlatSample:
    """`n` of the points of a cloud, farthest points from those next to `around` (if they
    are no more than `n`); the area of every point goes to the nearest of them. `order`:
    of the energy, whose lambda has the unit length^{2 order - m}."""
    points, areas = known
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
    local_lam = spacing ** (2 * order - source.dim)
    areas = areas * local_lam * np.sum(areas) / np.sum(areas * local_lam)
    weights = _shared_out(points, areas, points[index])
    chosen = points[index]
    if len(points) > len(source.known_points()[0]):  # those lie in triangles
        chosen = np.asarray(projected(source, chosen))
    return chosen, tangent_frames(source, chosen), weights


def _shared_out(points, areas, owners) -> np.ndarray:
    """The area of each point goes to the nearest owner; owners equally near share it."""
    near, equal = equally_near(owners, points)
    share = equal / np.sum(equal, axis=1, keepdims=True) * areas[:, None]
    return np.bincount(near.ravel(), share.ravel(), minlength=len(owners))


def voronoi_volumes(source, points, frames) -> np.ndarray:
    """Volume of each point's Voronoi cell on M. Quasi-random vectors u of a tangent ball
    are sent to M by u -> pi(p + E u); those that stay nearest to p count, each with the
    volume distortion of that map.

    **Raises** ValueError where that is not known."""
    if not source.isometric:
        raise ValueError(
            f"source: {type(source).__name__} has a metric of its own; its volumes are "
            "known by a chart: let its method `chart` return a `mr.Chart` with `metric`."
        )
    m = source.dim
    tree = KDTree(points)
    neighbours = min(len(points), 2 * m + 2)
    radius = tree.query(points, k=neighbours)[0][:, -1]
    ball = qmc.Sobol(m, rng=0).random(4 * TANGENT_SAMPLES) * 2 - 1
    ball = ball[np.sum(ball**2, axis=1) < 1]
    ball_volume = 2.0**m * len(ball) / (4 * TANGENT_SAMPLES)
    owner = source, ball
    landed, volume = at_each(_cell, owner, points, frames, radius, most=CELLS)
    nearest = tree.query(landed.reshape(-1, points.shape[1]))[1]
    own = nearest.reshape(len(points), -1) == np.arange(len(points))[:, None]
    return np.sum(own * volume, axis=1) * ball_volume / len(ball)


def _cell(owner, p, frame, r):
    """Where the vectors of a ball of radius r land, and the volumes there."""
    source, ball = owner

    def to_manifold(u):
        return source.project((p + frame @ u).reshape(source.point_shape)).ravel()

    landed = jax.vmap(to_manifold)(r * ball)
    jacobian = jax.vmap(jax.jacfwd(to_manifold))(r * ball)
    gram = jnp.einsum("usa,usb->uab", jacobian, jacobian)
    return landed, jnp.sqrt(jnp.linalg.det(gram)) * r**source.dim
