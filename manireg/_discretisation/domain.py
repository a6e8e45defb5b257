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

from .._sources.charts import chart_of
from .._sources.sources import Ambient, Source, sampled
from ..manifolds import AbstractManifold, PointCloud, Product
from .quadrature import axis_counts, gauss_panels, grid, of_cloud, quasi_uniform


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


_ON_CLOUD = 12  # points of a cloud per centre
_FEW = 12  # centres any cloud may have


def nodes_per_axis(m: int) -> int:
    """Gauss nodes a centre and axis."""
    return {1: 10, 2: 4}.get(m, 3)


def panels_of(m: int) -> tuple[int, int]:
    """Panels a spacing and nodes in each: if there can be two, the kernel's joints fall on
    panel ends."""
    nodes = nodes_per_axis(m)
    return (2, nodes // 2) if nodes % 2 == 0 else (1, nodes)


def centres_of(source: Source, n: int, around=None, graded: bool = False) -> Domain:
    """About `n` quasi-uniform points of `source`, boundary included, as basis centres.
    The weights are not meant for integration. Arguments as for `discretise`. A mesh
    gets at most as many as it has vertices, a point cloud without triangles a twelfth of
    its points, as its quadrature has no others."""
    _check_graded(source, around, graded)
    chart = chart_of(source, around)
    if chart is not None:
        spacings = axis_counts(chart, n)
        axes = []
        for low, high, periodic, count in zip(
            chart.lower, chart.upper, chart.periodic, spacings
        ):
            nodes = np.linspace(low, high, count + 1)
            axes.append(
                (nodes[:-1] if periodic else nodes, np.ones(count + 1 - periodic))
            )
        return with_second_forms(source, *grid(chart, axes))
    if isinstance(source, Product):
        return _product_domain(source, n, around, centres_of)
    if isinstance(source, Ambient):
        return ambient_domain(centres_of(source.manifold, n, around, graded))
    if isinstance(source, PointCloud):
        most = len(source.points)
        if source.triangles is None:  # the quadrature has no points between
            most = max(_FEW, most // _ON_CLOUD)
        n = min(n, most)
        return with_second_forms(source, *of_cloud(source, n, around, graded))
    return with_second_forms(source, *quasi_uniform(source, n, with_weights=False))


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

    Point clouds give points of theirs and share out the areas (a mesh with too few
    vertices points in its triangles); `Ambient` takes over what
    its manifold gives. Sources with a global chart use composite Gauss-Legendre rules
    (trapezoid rule along periodic coordinates), S^2 the Fibonacci lattice, products the
    product rule. Every other manifold takes farthest points of a cloud of
    `random_points`, weighted by the volume of their Voronoi cells, measured in the tangent
    space.
    """
    _check_graded(source, around, graded)
    per_axis = nodes_per_axis(source.dim)
    chart = chart_of(source, around)
    if chart is not None:
        axes = []
        for low, high, periodic, count in zip(
            chart.lower, chart.upper, chart.periodic, axis_counts(chart, n)
        ):
            if periodic:
                nodes = np.linspace(low, high, count * per_axis + 1)[:-1]
                axes.append((nodes, np.full(len(nodes), (high - low) / len(nodes))))
            else:
                panels, nodes = panels_of(source.dim)
                axes.append(gauss_panels(low, high, count * panels, nodes))
        return with_second_forms(source, *grid(chart, axes))
    if isinstance(source, Product):
        return _product_domain(source, n, around, discretise)
    if isinstance(source, Ambient):
        return ambient_domain(discretise(source.manifold, n, around, graded))
    if isinstance(source, PointCloud):
        n = min(n, len(source.points)) * _ON_CLOUD
        return with_second_forms(source, *of_cloud(source, n, around, graded))
    n = n * per_axis**source.dim
    return with_second_forms(source, *quasi_uniform(source, n, with_weights=True))


def _check_graded(source: Source, around, graded: bool) -> None:
    surface = sampled(source)
    if graded and not (isinstance(surface, PointCloud) and around is not None):
        raise ValueError(
            "graded: only for sources that are point clouds, and near data; found "
            f"{type(surface).__name__}. Leave it out."
        )


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


def ambient_domain(domain: Domain) -> Domain:
    """The same points and weights, all directions, no curvature."""
    Q, s, _ = domain.frames.shape
    frames = jnp.broadcast_to(jnp.eye(s), (Q, s, s))
    return Domain(domain.points, frames, jnp.zeros((Q, s, s, s)), domain.weights)


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
