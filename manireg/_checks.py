"""Bad input is named here, once, at the public boundary: what was found, what to do."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from ._sources import Ambient, Box, Interval, Source, sampled
from .manifolds import AbstractManifold, PointCloud

ON_MANIFOLD = 1e-6  # allowed distance of data to a manifold, relative to their size


def is_concrete(*values) -> bool:
    return not any(isinstance(v, Tracer) for v in values)


def check_x64():
    if not jax.config.read("jax_enable_x64"):
        raise ValueError(
            "manireg needs float64, but JAX is in float32 mode. Switch it on before the "
            'first JAX call: jax.config.update("jax_enable_x64", True).'
        )


def check_points(name: str, space: Source | AbstractManifold, points, count=None):
    """`points` as a float64 array `(n, t)` of flattened points of `space`."""
    if np.asarray(points).dtype.kind not in "fiu":
        raise ValueError(
            f"{name}: expected real numbers, found dtype {np.asarray(points).dtype}."
        )
    points = np.asarray(points, dtype=float)
    shape = space.point_shape
    if points.ndim != 1 + len(shape) or points.shape[1:] != shape:
        letters = ", ".join(map(str, ("k", *shape)))
        comma = "," if not shape else ""
        raise ValueError(
            f"{name}: expected shape ({letters}{comma}) for {_describe(space)}, found "
            f"{points.shape}."
        )
    if count is not None and len(points) != count:
        raise ValueError(
            f"{name}: expected {count} points, one for each input, found {len(points)}."
        )
    flat = points.reshape(len(points), -1)
    bad = np.flatnonzero(~np.all(np.isfinite(flat), axis=1))
    if len(bad):
        raise ValueError(
            f"{name}: {len(bad)} of {len(points)} points hold NaN or infinity (first at "
            f"index {bad[0]}); remove or impute them."
        )
    _check_on(name, space, points)
    return flat


def check_data(source: Source, target: AbstractManifold, x, y, weights):
    """Flattened `x (k, s)`, `y (k, t)` projected onto the target, `weights (k,)`."""
    if not isinstance(target, AbstractManifold):
        raise ValueError(
            f"target: expected a manireg manifold, found {type(target).__name__}."
        )
    x = check_points("x", source, x)
    y = check_points("y", target, y, count=len(x))
    least = source.dim + 2
    distinct = len(np.unique(x, axis=0))
    if distinct < least:
        raise ValueError(
            f"x: {distinct} distinct inputs are too few; a source of dimension "
            f"{source.dim} needs at least {least}."
        )
    if len(np.unique(np.concatenate([x, y], axis=1), axis=0)) < len(x):
        raise ValueError(
            "x, y: some pairs occur twice. Drop the copies, or give repeated "
            "measurements of one value a larger entry in `weights`."
        )
    y = projected(target, jnp.asarray(y).reshape(-1, *target.point_shape))
    if weights is None:
        weights = np.ones(len(x))
    weights = np.asarray(weights, dtype=float)
    if weights.shape != (len(x),):
        raise ValueError(
            f"weights: expected shape ({len(x)},), one for each pair, found "
            f"{weights.shape}."
        )
    if not (np.all(np.isfinite(weights)) and np.all(weights > 0)):
        raise ValueError(
            "weights: must be positive and finite; leave out pairs of weight zero."
        )
    return jnp.asarray(x), y.reshape(len(x), -1), jnp.asarray(weights)


def check_landmarks(
    name: str, surface: PointCloud, positions: np.ndarray
) -> np.ndarray:
    """The points of the surface closest to `positions`, which may lie up to a hundredth
    of its size away."""
    landed = np.asarray(projected(surface, jnp.asarray(positions)))
    gap = np.linalg.norm(landed - positions, axis=1)
    size = np.linalg.norm(np.ptp(np.asarray(surface.points), axis=0))
    if gap.max() > 1e-2 * size:
        raise ValueError(
            f"{name}: landmark {gap.argmax()} lies {gap.max():.3g} off the surface, more "
            f"than 1 % of its size ({size:.3g}). Wrong units or the wrong mesh?"
        )
    return landed


def check_tension(tension: float, source: Source):
    if not (np.isfinite(tension) and tension >= 0):
        raise ValueError(f"tension: must be finite and at least 0, found {tension}.")
    if tension and not isinstance(source, Ambient):
        raise ValueError(
            f"tension: only for `Ambient` sources, found {type(source).__name__}. Leave "
            "it out, or take Ambient(source)."
        )


def check_lam(lam, name="lam"):
    if not is_concrete(lam):
        return
    values = np.asarray(lam, dtype=float)
    if values.size == 0 or not (np.all(np.isfinite(values)) and np.all(values > 0)):
        raise ValueError(
            f"{name}: lambda must be positive and finite, found {lam}. For interpolation "
            "take a small value, for geodesic regression a large one."
        )


@eqx.filter_jit
def projected(space: AbstractManifold, points):
    """Closest points, compiled once a shape: iterations recompile outside of `jit`."""
    return space.project(points)


def _check_on(name, space, points):
    space = sampled(space)
    if isinstance(space, Box | Interval):
        lower, upper = space.bounds
        slack = 1e-9 * (upper - lower)
        flat = points.reshape(len(points), -1)
        outside = np.any((flat < lower - slack) | (flat > upper + slack), axis=1)
        where, cure = "outside", "widen it or drop them"
        worst = ""
    else:
        gap = np.asarray(projected(space, jnp.asarray(points))) - points
        distance = np.linalg.norm(gap.reshape(len(points), -1), axis=1)
        size = np.sqrt(np.mean(np.sum(points.reshape(len(points), -1) ** 2, axis=1)))
        outside = ~(distance <= _tolerance(space, max(size, 1e-300)))
        where, cure = "off", f"normalise them, e.g. with {name} = M.project({name})"
        worst = f", up to {np.nanmax(distance):.2g} away" if outside.any() else ""
    if outside.any():
        raise ValueError(
            f"{name}: {outside.sum()} of {len(points)} points lie {where} "
            f"{_describe(space)} (first at index {np.flatnonzero(outside)[0]}{worst}); "
            f"{cure}."
        )


def _tolerance(space, size):
    """A point cloud is known as well as its points are dense."""
    if isinstance(space, PointCloud):
        areas = np.asarray(space.areas)
        return 0.5 * float(np.median(areas[areas > 0])) ** (1 / space.dim)
    return ON_MANIFOLD * size


def _describe(space) -> str:
    if isinstance(space, Interval):
        return f"the interval [{space.a:g}, {space.b:g}]"
    if isinstance(space, Box):
        return f"the box {list(space.lower)} to {list(space.upper)}"
    return type(space).__name__
