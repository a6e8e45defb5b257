"""Centres and quadrature that follow the data where those cluster (`local_spacing`)."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from .._source import AbstractSource, Atlas
from ..manifolds._defaults.frames import tangent_frames
from ..manifolds._membership import projected
from .cells import even_cells, graded_cells, on_cells
from .domain import (
    Domain,
    nodes_per_axis,
    panels_of,
    sample_domain,
    seen_from,
    with_second_forms,
)
from .local_spacing import LocalSpacing
from .quadrature import CANDIDATES, gauss_panels, voronoi_volumes
from .spacing import farthest_indices, local_spacings

# Far supports reach in: so, as many overlap as in an even spread.
NARROWER = 0.86
HALVINGS = 10  # of an interval of log scales
FAR = 0.25  # of the candidates: anywhere on the source


class Followed(NamedTuple):
    nodes: Domain
    spacings: Float[np.ndarray, " K"]
    """Around each node."""
    quadrature: Domain


def follow(
    source: AbstractSource,
    spacing: LocalSpacing,
    n: int,
    around,
    finer: bool,
    order: int,
) -> Followed | None:
    """At most `n` centres (about, on sources without charts) whose spacing is that of the
    data around them, or more by the same factor everywhere; with `finer` also less, as far
    as `n` goes. None on point clouds, whose points are all there is, and for products with
    a factor that has no charts. `order`: of the energy."""
    manifold = source.sampled
    atlas = manifold.atlas(np.asarray(around))
    if atlas is not None:
        followed = _in_charts(atlas, spacing, n, finer, order)
    elif manifold.known_points() is not None or manifold.product(None) is not None:
        return None
    else:
        followed = _scattered(manifold, spacing, n, finer, order)
    if followed is None:
        return None
    nodes, spacings, quadrature = followed
    return Followed(seen_from(source, nodes), spacings, seen_from(source, quadrature))


def _in_charts(
    atlas: Atlas, spacing: LocalSpacing, n: int, finer: bool, order: int
) -> Followed | None:
    """Cells, a centre in the middle of each, Gauss points in all."""
    m = atlas.lower.shape[1]
    divide = even_cells if m == 1 else graded_cells
    fits = lambda scale: divide(atlas, spacing.at(scale), n) is not None
    scale = _least_scale(fits, spacing, finer)
    if scale is None:
        return None
    cells = divide(atlas, spacing.at(scale), n)
    assert cells is not None
    nodes = sample_domain(on_cells(atlas, cells))
    h = spacing.at(scale)(np.asarray(nodes.points))
    h = np.asarray(nodes.weights) if m == 1 else NARROWER * h
    x, weights = gauss_panels(-1.0, 1.0, *panels_of(nodes_per_axis(m)))
    quadrature = sample_domain(on_cells(atlas, cells, (x, weights / 2), order))
    return Followed(nodes, h, quadrature)


def _scattered(
    source, spacing: LocalSpacing, n: int, finer: bool, order: int
) -> Followed | None:
    """Farthest points in units of the spacing, among random ones that are dense where it
    is small; weights are volumes of Voronoi cells."""
    m = source.dim
    Q = n * nodes_per_axis(m) ** m
    cloud = _candidates(source, spacing, CANDIDATES * Q)
    own = local_spacings(cloud, m)
    fits = lambda scale: np.sum((own / spacing.at(scale)(cloud)) ** m) <= n
    scale = _least_scale(fits, spacing, finer)
    if scale is None:
        return None
    spacing = spacing.at(scale)
    h = spacing(cloud)
    n = round(np.sum((own / h) ** m))
    Q = n * nodes_per_axis(m) ** m
    chosen = farthest_indices(cloud, Q, spacing=h, growth=spacing.growth)
    points = cloud[chosen]
    frames = tangent_frames(source, points)
    weights = voronoi_volumes(source, points, frames)
    quadrature = with_second_forms(source, points, frames, weights, order)
    # the first of farthest points are farthest points, too
    nodes = with_second_forms(source, points[:n], frames[:n], np.ones(n))
    return Followed(nodes, NARROWER * local_spacings(points[:n], m), quadrature)


def _candidates(source, spacing: LocalSpacing, n: int) -> Float[np.ndarray, "n s"]:
    """Random points: some anywhere, the others around the data at distances spread evenly
    on a logarithmic scale."""
    rng = np.random.default_rng(0)
    anywhere = source.random_points(jax.random.key(0), round(FAR * n))
    anywhere = np.asarray(anywhere).reshape(round(FAR * n), -1)
    site = rng.integers(len(spacing.sites), size=n - len(anywhere))
    nearest, farthest = 0.1 * spacing.spacings[site], 3 * spacing.largest
    farthest = min(farthest, 0.5 * float(source.reach))
    distance = nearest * (farthest / nearest) ** rng.random(len(site))
    direction = rng.normal(size=(len(site), source.dim))
    direction *= (distance / np.linalg.norm(direction, axis=1))[:, None]
    frames = tangent_frames(source, spacing.sites)[site]
    near = spacing.sites[site] + np.einsum("nsa,na->ns", frames, direction)
    near = projected(source, near.reshape(-1, *source.point_shape))
    near = np.asarray(near).reshape(len(site), -1)
    return np.concatenate([anywhere, near[np.all(np.isfinite(near), axis=1)]])


def _least_scale(
    fits: Callable[[float], bool], spacing: LocalSpacing, finer: bool
) -> float | None:
    """The least factor that fits, at least 1 unless `finer`; None if none does."""
    high = 1.0
    while not fits(high):
        if high * np.min(spacing.spacings) > spacing.largest:
            return None
        high *= 2
    low = high / 2
    if high == 1:
        if not finer:
            return high
        while fits(low):
            low, high = low / 2, low
    for _ in range(HALVINGS):
        middle = np.sqrt(low * high)
        low, high = (low, middle) if fits(middle) else (middle, high)
    return high
