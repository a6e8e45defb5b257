"""Source manifold -> points with frames, second fundamental forms and weights.

`Domain` is the hinge of the library: quadrature points and centres of the basis are both
Domains, and whatever can produce one (an interval, a box, a sphere, a scanned surface)
can be the source of a regression.
"""

import dataclasses
import functools
from collections.abc import Callable

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from .._programs.sizes import at_each
from .._source import AbstractSource, Chart
from .geodesics import geodesics_of_manifold
from .partial_derivatives import partial_derivatives
from .quadrature import Sample, axis_counts, gauss_panels, grid, of_known, quasi_uniform


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
    higher: Float[Array, "Q R s"] | None = None
    """Partial derivatives of exp_x(E u) at u = 0 beyond the second, in the order of
    `partial_derivatives`; None: not known, or 0 as the second forms are."""

    @property
    def dim(self) -> int:
        return self.frames.shape[-1]

    @property
    def isometric(self) -> bool:
        """Whether lengths are those of the ambient space: frames are orthonormal there."""
        frames = np.asarray(self.frames)
        gram = np.swapaxes(frames, 1, 2) @ frames
        return bool(np.allclose(gram, np.eye(self.dim), atol=1e-6))

    def geodesics(self, order: int) -> Float[np.ndarray, "Q J s"]:
        """All of them up to that order: the points, the frames, the second forms, ...

        **Raises** ValueError where they are not known."""
        m = self.dim
        points, frames, forms = map(
            np.asarray, (self.points, self.frames, self.second_forms)
        )
        rows = [points, *np.moveaxis(frames, 2, 0)]
        rows += [forms[:, a, b] for a in range(m) for b in range(a, m)]
        known, count = np.stack(rows, axis=1), len(partial_derivatives(m, order))
        if self.higher is not None:
            known = np.concatenate([known, self.higher], axis=1)
        elif not np.any(forms):
            known = np.pad(known, ((0, 0), (0, max(0, count - len(rows))), (0, 0)))
        if known.shape[1] < count:
            raise ValueError(
                f"domain: energies of order {order} need its geodesics to that order; "
                "give `higher`, their partial derivatives beyond the second."
            )
        return known[:, :count]


_ON_CLOUD = 12  # points of a cloud per centre
_FEW = 12  # centres any cloud may have


def nodes_per_axis(m: int) -> int:
    """Gauss nodes a centre and axis."""
    return {1: 10, 2: 4}.get(m, 3)


def panels_of(nodes: int) -> tuple[int, int]:
    """Panels a spacing and nodes in each, of so many nodes a spacing: if there can be two
    panels, the kernel's joints fall on their ends."""
    return (2, nodes // 2) if nodes % 2 == 0 else (1, nodes)


def centres_of(
    source: AbstractSource, n: int, around=None, graded: bool = False
) -> Domain:
    """About `n` quasi-uniform points of `source`, boundary included, as basis centres.
    The weights are not meant for integration. Arguments as for `discretise`. A mesh
    gets at most as many as it has vertices, a point cloud without triangles a twelfth of
    its points, as its quadrature has no others."""
    around = _checked_data(source, around, graded)
    return seen_from(source, _centres(source.sampled, n, around, graded))


def _centres(source: AbstractSource, n: int, around, graded: bool = False) -> Domain:
    chart = source.chart(around)
    if chart is not None:
        return sample_domain(grid(chart, _nodes(chart, n)))
    if source.product(around) is not None:
        return _product_domain(source, n, around, _centres)
    if (known := source.known_points()) is not None:
        size = len(known[0])
        more, _ = source.known_points(size + 1) or known
        most = size if len(more) > size else max(_FEW, size // _ON_CLOUD)
        n = min(n, most, size)
        return with_second_forms(source, *of_known(source, known, n, around, graded))
    return with_second_forms(source, *quasi_uniform(source, n, with_weights=False))


def _nodes(chart: Chart, n: int):
    """The ends of about `n` cells of a chart, along each axis."""
    axes = []
    for low, high, periodic, count in zip(
        chart.lower, chart.upper, chart.periodic, axis_counts(chart, n)
    ):
        nodes = np.linspace(low, high, count + 1)
        axes.append((nodes[:-1] if periodic else nodes, np.ones(count + 1 - periodic)))
    return axes


def discretise(
    source: AbstractSource, n: int, around=None, graded: bool = False, order: int = 2
) -> Domain:
    """Quadrature for a basis of about `n` centres: 10 points a centre on curves, 16 on
    surfaces (12 on point clouds), 27 in dimension 3 (fewer hides stiff modes of the
    energy); products as any other source of their dimension.

    **Arguments:**

    - `source`: an `Interval`, a `Box` or any other source.
    - `n`: the number of centres of the basis.
    - `around`: data points (flattened). Unbounded sources (Euclidean space, cylinder,
      SPD matrices) are cut to the box that holds them, which is then required.
    - `graded`: points denser near `around`, weights in proportion to spacing^{2 order - m}
      with the same sum; point clouds only.
    - `order`: of the energy, to which geodesics are known (on point clouds to the second).

    Point clouds give points of theirs and share out the areas (a mesh with too few
    vertices points in its triangles); `Ambient` takes over what
    its manifold gives. Sources with a global chart use composite Gauss-Legendre rules
    (trapezoid rule along periodic coordinates), S^2 the Fibonacci lattice, products the
    product rule. Every other manifold takes farthest points of a cloud of
    `random_points`, weighted by the volume of their Voronoi cells, measured in the tangent
    space.
    """
    around = _checked_data(source, around, graded)
    nodes = nodes_per_axis(source.sampled.dim)
    domain = _quadrature(source.sampled, n, around, nodes, graded, order)
    return seen_from(source, domain)


def _quadrature(
    source: AbstractSource,
    n: int,
    around,
    nodes: int,
    graded: bool = False,
    order: int = 2,
) -> Domain:
    """`nodes`: a centre and axis. Factors of products have those of the whole: with those
    of curves and surfaces of their own, there would be 160 a centre on S^2 x R."""
    chart = source.chart(around)
    if chart is not None:
        return sample_domain(grid(chart, _rules(chart, n, nodes), order))
    if source.product(around) is not None:
        build = functools.partial(_quadrature, nodes=nodes)
        return _product_domain(source, n, around, build, order)
    if (known := source.known_points()) is not None:
        n = min(n, len(known[0])) * _ON_CLOUD
        known = source.known_points(n) or known
        sample = of_known(source, known, n, around, graded, order)
        return with_second_forms(source, *sample)
    n = n * nodes**source.dim
    sample = quasi_uniform(source, n, with_weights=True)
    return with_second_forms(source, *sample, order)


def _rules(chart: Chart, n: int, nodes: int):
    """Rules for about `n` cells of a chart, along each axis."""
    axes = []
    for low, high, periodic, count in zip(
        chart.lower, chart.upper, chart.periodic, axis_counts(chart, n)
    ):
        if periodic:
            even = np.linspace(low, high, count * nodes + 1)[:-1]
            axes.append((even, np.full(len(even), (high - low) / len(even))))
        else:
            panels, inside = panels_of(nodes)
            axes.append(gauss_panels(low, high, count * panels, inside))
    return axes


def _checked_data(source: AbstractSource, around, graded: bool) -> np.ndarray | None:
    surface = source.sampled
    if graded and (surface.known_points() is None or around is None):
        raise ValueError(
            "graded: only for sources that are point clouds, and near data; found "
            f"{type(surface).__name__}. Leave it out."
        )
    return None if around is None else np.asarray(around)


def _product_domain(
    source: AbstractSource, n: int, around, build: Callable[..., Domain], order: int = 2
) -> Domain:
    """Product rule: n is shared out so that all factors get about the same spacing."""
    domains = [
        _scaled(build(factor, max(4, round(n ** (factor.dim / source.dim))), x), scale)
        for factor, x, scale in source.product(around) or ()
    ]
    index = np.stack(
        np.meshgrid(*(np.arange(len(d.points)) for d in domains), indexing="ij"), -1
    ).reshape(-1, len(domains))
    pick = lambda a, i: np.asarray(a)[index[:, i]]
    picked = [jax.tree.map(lambda a, i=i: pick(a, i), d) for i, d in enumerate(domains)]
    frames = np.zeros((len(index), sum(d.frames.shape[1] for d in picked), source.dim))
    row = column = 0
    for d in picked:
        s, m = d.frames.shape[1:]
        frames[:, row : row + s, column : column + m] = d.frames
        row, column = row + s, column + m
    points = np.concatenate([d.points for d in picked], axis=1)
    weights = functools.reduce(np.multiply, (d.weights for d in picked))
    return with_second_forms(source, points, frames, weights, order)


def _scaled(domain: Domain, scale: float) -> Domain:
    """Points and weights; what is picked of the rest are frames, orthonormal at any
    size."""
    m = domain.frames.shape[2]
    points, weights = scale * domain.points, scale**m * domain.weights
    return dataclasses.replace(domain, points=points, weights=weights)


def seen_from(source: AbstractSource, domain: Domain) -> Domain:
    """The same points and weights, with the directions that the source differentiates
    along."""
    if source.sampled is source:
        return domain
    frames, forms = source.directions(domain.frames, domain.second_forms)
    return Domain(domain.points, frames, forms, domain.weights)


def sample_domain(sample: Sample) -> Domain:
    return Domain(*jax.device_put(sample))


def with_second_forms(manifold, points, frames, weights, order: int = 2) -> Domain:
    """With the second fundamental forms of a manifold, and its geodesics to that order."""
    forms = at_each(_second_forms, manifold, points, frames)
    higher = None
    if order > 2 and np.any(forms):
        higher = geodesics_of_manifold(manifold, points, frames, order)
    return sample_domain((points, frames, forms, weights, higher))


def _second_forms(manifold, p, frame):
    shape = manifold.point_shape

    def form(a, b):
        ambient = (v.reshape(shape) for v in (p, a, b))
        return manifold.second_fundamental_form(*ambient).ravel()

    over_b = jax.vmap(form, in_axes=(None, 1))
    return jax.vmap(over_b, in_axes=(1, None))(frame, frame)
