"""Whether points lie where they should: bounds in their own unit, a manifold by its own
size, each factor of a product for itself."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from ..manifolds import (
    AbstractManifold,
    FlatTorus,
    PointCloud,
    Product,
    SpecialOrthogonal,
    Sphere,
)
from .sources import Box, Interval, Source, listed, sampled

ON_MANIFOLD = 1e-6  # allowed distance of data to a manifold, in its smallest radii
ROUNDING = 64 * np.finfo(float).eps  # of coordinates, passed without another look


def is_concrete(*values) -> bool:
    return not any(isinstance(v, Tracer) for v in values)


@eqx.filter_jit
def projected(space: AbstractManifold, points):
    """Closest points, compiled once a shape: iterations recompile outside of `jit`."""
    return space.project(points)


def check_on(name: str, space: Source | AbstractManifold, points, unit: str = ""):
    """`points`, `(k, *point_shape)`, lie on `space`. `unit`: of converted dates."""
    space = sampled(space)
    if isinstance(space, Box | Interval):
        return _check_inside(name, space, points, unit)
    if not is_concrete(*jax.tree.leaves(space)):
        return
    with jax.ensure_compile_time_eval():  # under `jit`, too: these points are known
        here = jnp.asarray(points)
        parts = factors(space, here, projected(space, here) - here)
    for label, factor, here, gap in parts:
        _check_near(name, label, factor, np.asarray(here), np.asarray(gap))


def outside(space: Box | Interval, flat):
    """Which points `(n, m)` lie outside, by more than rounding."""
    lower, upper = space.bounds
    size = np.maximum(np.abs(lower), np.abs(upper))
    slack = np.maximum(1e-9 * (upper - lower), 4 * np.finfo(float).eps * size)
    return ((flat < lower - slack) | (flat > upper + slack)).any(axis=1)


def described(space) -> str:
    if isinstance(space, Interval):
        return f"the interval {listed([space.a, space.b])}"
    if isinstance(space, Box):
        return f"the box {listed(space.lower)} to {listed(space.upper)}"
    return type(space).__name__


def _check_inside(name, space, points, unit):
    out = np.flatnonzero(outside(space, points.reshape(len(points), -1)))
    if len(out):
        unit = f", in {unit}" if unit else ""
        raise ValueError(
            f"{name}: {len(out)} of {len(points)} points lie outside {described(space)} "
            f"(first at index {out[0]}: {listed(points[out[0]])}{unit}); widen it or drop "
            "them."
        )


@functools.singledispatch
def factors(space, *arrays):
    """The independent parts of a manifold: `(label, part, *arrays)`, arrays cut to it."""
    return [(type(space).__name__, space, *arrays)]


@factors.register
def _(space: Product, *arrays):
    parts = zip(space.factors, *map(space.split, arrays), strict=True)
    return [
        (f"factor {i}, {label}", *inner)
        for i, part in enumerate(parts)
        for label, *inner in factors(*part)
    ]


@factors.register
def _(space: FlatTorus, *arrays):
    """Circles: a wide one has no say in how close to a small one is close."""
    radii = np.broadcast_to(np.asarray(space.radii), space.dim)
    return [
        (
            f"FlatTorus, circle {i}" if space.dim > 1 else "FlatTorus",
            Sphere(1, float(radius)),
            *(a.reshape(len(a), -1, 2)[:, i] for a in arrays),
        )
        for i, radius in enumerate(radii)
    ]


def _check_near(name, label, space, points, gap):
    flat = points.reshape(len(points), -1)
    distance = np.linalg.norm(gap.reshape(len(points), -1), axis=1)
    largest = np.max(np.abs(flat), initial=0.0)
    off = ~(distance <= ROUNDING * largest)
    if off.any():  # a reach may have to be worked out
        off = ~(distance <= max(ROUNDING * largest, _tolerance(space, flat)))
    if not off.any():
        return
    first, count = np.flatnonzero(off)[0], f"{off.sum()} of {len(points)}"
    if isinstance(space, SpecialOrthogonal):
        mirrored = np.flatnonzero(off & (np.linalg.det(points) < 0))
        if len(mirrored):
            raise ValueError(
                f"{name}: {len(mirrored)} of {len(points)} matrices are reflections, not "
                f"rotations of {label}: their determinant is negative (first at index "
                f"{mirrored[0]}). An axis is mirrored or two are swapped, which no "
                "projection mends: change the sign of that row or column, or leave these "
                "points out."
            )
    known = distance[np.isfinite(distance)]
    worst = f", up to {known.max():.2g} away" if len(known) else ""
    worst += ", some without a closest point" if len(known) < len(distance) else ""
    raise ValueError(
        f"{name}: {count} points lie off {label} (first at index {first}{worst}); "
        f"normalise them, e.g. with {name} = M.project({name})."
    )


def _tolerance(space, flat) -> float:
    """A manifold is known to a millionth of its reach, the smallest radius at which it
    bends or meets itself (a flat one of the size of the data), a point cloud as well as
    its points are dense."""
    if isinstance(space, PointCloud):
        areas = np.asarray(space.areas)
        return 0.5 * float(np.median(areas[areas > 0])) ** (1 / space.dim)
    with jax.ensure_compile_time_eval():
        reach = float(np.asarray(space.reach))
    if np.isfinite(reach):
        return ON_MANIFOLD * reach
    return ON_MANIFOLD * float(np.sqrt(np.mean(np.sum(flat**2, axis=1))))
