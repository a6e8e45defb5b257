"""Bad input is named here, once, at the public boundary: what was found, what to do."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._input.numbers import Numbers, as_numbers, numbers_and_unit
from .._input.positive import refuse_other_than_positive
from .._input.precision import as_scalar
from .._source import AbstractSource
from ..manifolds import AbstractManifold, PointCloud
from ..manifolds._membership import is_concrete as is_concrete, projected as projected


def check_points(name: str, space: AbstractSource, points, count=None):
    """`points` as a float64 array `(n, t)` of ambient coordinates of points of `space`."""
    return _checked(name, space, *_numbers_of(name, space, points), count)


def _checked(name, space, points: np.ndarray, unit: str, count=None) -> np.ndarray:
    shape = space.point_shape
    points = _as_batch(points, shape)
    if points.ndim != 1 + len(shape) or points.shape[1:] != shape:
        raise ValueError(_wrong_shape(name, space, points.shape))
    if count is not None and len(points) != count:
        raise ValueError(
            f"{name}: expected {count} points, one for each input, found {len(points)}."
        )
    flat = points.reshape(len(points), -1)
    bad = np.flatnonzero(~np.all(np.isfinite(flat), axis=1))
    if len(bad):
        raise ValueError(
            f"{name}: {len(bad)} of {len(points)} points hold NaN or infinity or are "
            f"missing (first at index {bad[0]}); remove or impute them."
        )
    space.check_points(name, points, unit)
    return np.asarray(space.to_ambient(points))


def check_inputs(source: AbstractSource, x) -> tuple[Array, bool]:
    """Ambient coordinates `(n, s)` of new inputs of a fitted model, and whether they are a
    single point. What can be told of traced ones at run time is: NaN, and where the source
    has ends."""
    shape = source.point_shape
    if is_concrete(x):
        x, unit = _numbers_of("x", source, x)
        single = x.shape == shape
        x = x[None] if single else x
        return jax.device_put(_checked("x", source, x, unit)), single
    x = jnp.asarray(x, float)
    single = x.shape == shape
    x = x[None] if single else _as_batch(x, shape)
    if x.shape[1:] != shape or x.ndim != 1 + len(shape):
        raise ValueError(_wrong_shape("x", source, x.shape))
    bad = jnp.any(source.outside(x)) | ~jnp.all(jnp.isfinite(x))
    message = (
        f"x: some points lie outside {source.description} or hold NaN or infinity."
    )
    return source.to_ambient(eqx.error_if(x, bad, message)), single


def check_target(target: AbstractManifold):
    if not isinstance(target, AbstractManifold):
        raise ValueError(
            f"target: expected a manireg manifold, found {type(target).__name__}."
        )


def check_source(source: AbstractSource):
    if not isinstance(source, AbstractSource):
        raise ValueError(
            "source: expected an Interval, a Circle, a Box, an Ambient, a manifold or "
            f"another AbstractSource, found {type(source).__name__}."
        )
    source.check_connected()


OFF_SURFACE = 0.02  # of the size of a surface: so far from it may landmarks lie
LANDINGS, STILL = 4, 1e-9  # projections, and what the last may move, of the size


def check_landmarks(
    name: str,
    surface: PointCloud,
    positions: np.ndarray,
    labels: Sequence[str] | None = None,
    hint: str = "Wrong units or the wrong mesh?",
) -> np.ndarray:
    """The points of the surface closest to `positions`, which may lie up to a fiftieth of
    its size away. `labels`: what to call them, default their numbers from 0."""
    landed = _landed(surface, positions)
    gap = np.linalg.norm(landed - positions, axis=1)
    size = np.linalg.norm(np.ptp(np.asarray(surface.points), axis=0))
    if gap.max() > OFF_SURFACE * size:
        worst = gap.argmax()
        label = worst if labels is None else labels[worst]
        raise ValueError(
            f"{name}: landmark {label} lies {gap.max():.3g} off the surface, more than "
            f"{100 * OFF_SURFACE:g} % of its size ({size:.3g}). {hint}"
        )
    return landed


def _landed(surface: PointCloud, positions: np.ndarray) -> np.ndarray:
    """Closest points that are their own closest points. Near another sheet, as of thin
    bone, the patch of the nearest point can end beyond a point of that sheet, whose patch
    is then the one that counts; where two pass points to and fro, the nearest vertex."""
    size = np.max(np.ptp(np.asarray(surface.points), axis=0))
    landed = moving = positions
    for _ in range(LANDINGS):
        before, landed = landed, np.asarray(projected(surface, landed))
        moving = np.linalg.norm(landed - before, axis=1) > STILL * size
        if not np.any(moving):
            return landed
    nearest = surface.points[surface.nearest(jnp.asarray(positions))]
    return np.where(moving[:, None], np.asarray(nearest), landed)


_LAM = (
    "lambda must be positive and finite",
    "For interpolation take a small value, for geodesic regression a large one.",
)


def check_lam(lam: Numbers) -> Array:
    """One lambda, as an array `()`."""
    return check_positive("lam", lam, *_LAM)


def check_lams(lams: Numbers) -> np.ndarray:
    """A grid of lambdas, ascending and without repetitions."""
    return check_grid("lams", lams, *_LAM)


def check_positive(name: str, value: Numbers, demand: str, cure: str) -> Array:
    """One positive number, given in any array of size 1, as an array `()`."""
    value = value if not is_concrete(value) else as_numbers(name, value)
    if value.size != 1:
        raise ValueError(f"{name}: expected one number, found shape {value.shape}.")
    if is_concrete(value):
        refuse_other_than_positive(name, value.ravel(), demand, cure)
    return as_scalar(value).reshape(())


def check_grid(name: str, values: Numbers, demand: str, cure: str) -> np.ndarray:
    """Positive numbers, ascending and without repetitions."""
    values = as_numbers(name, values).ravel()
    if values.size == 0:
        raise ValueError(f"{name}: {demand}, found none. {cure}")
    refuse_other_than_positive(name, values, demand, cure)
    return np.unique(values)


def _numbers_of(name: str, space, points) -> tuple[np.ndarray, str]:
    """Dates only where points are plain numbers."""
    if space.linear:
        return numbers_and_unit(name, points)
    return as_numbers(name, points), ""


def _as_batch(x, shape: tuple[int, ...]):
    """Columns of plain numbers are taken as numbers."""
    return x[:, 0] if shape == () and x.ndim == 2 and x.shape[1] == 1 else x


def _wrong_shape(name: str, space, found: tuple[int, ...]) -> str:
    letters = ", ".join(map(str, ("k", *space.point_shape)))
    comma = "," if not space.point_shape else ""
    expected = f"({letters}{comma}) for {space.description}"
    return f"{name}: expected shape {expected}, found {found}."
