"""Directions in which maps from a source are differentiated, at one point in ambient
coordinates; all of it under `jit`."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._source import AbstractSource, Chart
from ..manifolds import AbstractManifold
from ..manifolds._defaults.covariant_derivative import derivatives_along
from ..manifolds._defaults.frames import orthonormal_columns

STARTS = {1: 256, 2: 24}  # coordinates along each axis, to find those of a point
FEWEST_STARTS = 8
STEPS = 12  # of Gauss and Newton, from there
LONG = 0.4  # of the longest squared projection of an axis
FOUND = 1e-6  # distance that may be left, in lengths of the vectors of coordinates


def curved(source: AbstractSource) -> AbstractSource | None:
    """What the others ask for: None for parts of a vector space, whose bounds then are no
    part of a program."""
    flat = source.linear or source.sampled is not source
    return None if flat else source


def along_curve(
    source: AbstractSource | None, p: Float[Array, " s"], order: int
) -> tuple[Float[Array, " s"], ...]:
    """p and its derivatives along a source of dimension 1, by x where that is a number,
    else by the length; up to the second."""
    if source is None:
        return (p, jnp.ones_like(p), *[jnp.zeros_like(p)] * (order - 1))
    if math.prod(source.point_shape) == 1:
        x = source.from_ambient(p[None])[0]
        curve = lambda x: source.to_ambient(x[None])[0]
        higher = [jnp.zeros_like(x)] * (order - 1)
        return derivatives_along(curve, order)(x, jnp.ones_like(x), *higher)
    e = frame_at(source, p)[:, 0]
    return (p, e) if order == 1 else (p, e, _bend(source, p, e))


def frame_at(
    source: AbstractSource | None, p: Float[Array, " s"]
) -> Float[Array, "s m"]:
    """Orthonormal columns that span the tangent space: the axes of a vector space; in a
    curve in the plane counterclockwise around the origin."""
    s = len(p)
    if source is None:
        return jnp.eye(s)
    m = source.dim
    if isinstance(source, AbstractManifold):
        frame = jnp.eye(s) if m == s else _image(_projector(source, p), m)
        if not source.isometric:
            images = orthonormal_columns(source, p.reshape(source.point_shape), frame)
            frame = _orthonormal_in(images.T @ images, frame)
        if (m, s) == (1, 2):
            across = p[0] * frame[1, 0] - p[1] * frame[0, 0]
            frame *= jnp.where(across < 0, -1.0, 1.0)
        return frame
    if m == s:
        return jnp.eye(s)
    if math.prod(source.point_shape) == m:
        x = source.from_ambient(p[None])[0]
        to_ambient = lambda x: source.to_ambient(x[None])[0]
        return _orthonormal(jax.jacfwd(to_ambient)(x).reshape(s, m))
    chart = _chart(source)
    u = _coordinates(chart, p)
    vectors = jax.jacfwd(chart.embed)(u)
    if chart.metric is None:
        return _orthonormal(vectors)
    return _orthonormal_in(chart.metric(u), vectors)


def _projector(source: AbstractManifold, p: Float[Array, " s"]) -> Float[Array, "s s"]:
    """To the tangent space."""
    point, axes = p.reshape(source.point_shape), jnp.eye(len(p))
    project = lambda v: source.tangent_projection(point, v.reshape(point.shape)).ravel()
    return jax.vmap(project, out_axes=1)(axes)


def _image(projector: Float[Array, "s s"], m: int) -> Float[Array, "s m"]:
    """Orthonormal columns that span it, of rank m: the first axes that are not too far
    from it, projected. Unlike eigenvectors they do not hang on rounding errors."""
    columns = []
    for _ in range(m):
        lengths = jnp.sum(projector**2, axis=0)
        e = projector[:, jnp.argmax(lengths > LONG * jnp.max(lengths))]
        for other in columns:
            e = e - other * (other @ e)
        e = e / jnp.linalg.norm(e)
        columns.append(e)
        projector = projector - jnp.outer(e, e @ projector)
    return jnp.stack(columns, axis=1)


def _bend(source: AbstractSource, p: Float[Array, " s"], e: Float[Array, " s"]):
    """The second derivative by the length, II(e, e)."""
    if isinstance(source, AbstractManifold):
        points = (v.reshape(source.point_shape) for v in (p, e, e))
        return source.second_fundamental_form(*points).ravel()
    chart = _chart(source)
    one, none = jnp.ones(1), jnp.zeros(1)
    u = _coordinates(chart, p)
    _, first, second = derivatives_along(chart.embed, 2)(u, one, none)
    own = chart.metric
    if own is None:
        return (second - e * (e @ second)) / (first @ first)
    metric, slope = jax.jvp(lambda u: own(u)[0, 0], (u,), (one,))
    return (second - first * slope / (2 * metric)) / metric


def _chart(source: AbstractSource) -> Chart:
    chart = source.chart(None)
    if chart is None:
        raise ValueError(
            f"source: tangent spaces of {type(source).__name__} are not known; let its "
            "method `chart` return a `mr.Chart`, or make it an AbstractManifold."
        )
    return chart


def _coordinates(chart: Chart, p: Float[Array, " s"]) -> Float[Array, " m"]:
    """Of a point in a chart, from the nearest one of a grid; NaN where there are none."""
    m = len(chart.lower)
    count = STARTS.get(m, FEWEST_STARTS)
    axes = [
        np.linspace(a, b, count) for a, b in zip(chart.lower, chart.upper, strict=True)
    ]
    grid = jnp.asarray(np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, m))
    gaps = jnp.sum((jax.vmap(chart.embed)(grid) - p) ** 2, axis=1)

    def nearer(_, u):
        slope = jax.jacfwd(chart.embed)(u)
        normal = slope.T @ slope
        return u + jnp.linalg.solve(normal, slope.T @ (p - chart.embed(u)))

    u = jax.lax.fori_loop(0, STEPS, nearer, grid[jnp.argmin(gaps)])
    gap = jnp.linalg.norm(chart.embed(u) - p)
    size = jnp.linalg.norm(jax.jacfwd(chart.embed)(u))
    return jnp.where(gap <= FOUND * size, u, jnp.nan)


def _orthonormal(vectors: Float[Array, "s m"]) -> Float[Array, "s m"]:
    """Columns of the same spans, one after the other, turned as little as that allows."""
    columns = []
    for v in vectors.T:
        for e in columns * 2:  # twice is enough
            v = v - e * (e @ v)
        columns.append(v / jnp.linalg.norm(v))
    return jnp.stack(columns, axis=1)


def _orthonormal_in(
    metric: Float[Array, "m m"], vectors: Float[Array, "s m"]
) -> Float[Array, "s m"]:
    """The same in a metric of their coefficients."""
    root = jnp.linalg.cholesky(metric)
    return jax.scipy.linalg.solve_triangular(root, vectors.T, lower=True).T
