"""Sources that are no manifolds: intervals, boxes, the neighbourhood of a surface."""

import abc
import math
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from .._input.numbers import Numbers, numbers_and_unit
from .._input.shown import listed
from .._source import AbstractSource, Chart, itself
from ..manifolds import AbstractManifold


class AbstractBounded(AbstractSource):
    """A box of coordinates that are x themselves."""

    @property
    @abc.abstractmethod
    def bounds(self) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """Lower and upper ends."""

    @property
    def linear(self) -> bool:
        return True

    def chart(self, around: np.ndarray | None) -> Chart:
        return Chart(*self.bounds, (False,) * self.dim, itself)

    def outside(self, x: Float[Any, "k ..."]) -> Bool[Any, " k"]:
        lower, upper = self.bounds
        size = np.maximum(np.abs(lower), np.abs(upper))
        slack = np.maximum(1e-9 * (upper - lower), 4 * np.finfo(float).eps * size)
        flat = self.to_ambient(x)
        return ((flat < lower - slack) | (flat > upper + slack)).any(axis=1)


class Box(AbstractBounded):
    r"""The box $\prod_a [lower_a, upper_a] \subset \mathbb{R}^m$ as a source.

    **Arguments:** `lower`, `upper`: sequences of m numbers (or dates, as of `Interval`),
    lower < upper. Points are arrays `(..., m)`.

    **Example:**

    ```python
    mr.Box([0, 0], [18, 18])  # a slice of 18 mm by 18 mm
    ```
    """

    lower: tuple[float, ...] = eqx.field(static=True, converter=lambda v: _bounds(v))
    upper: tuple[float, ...] = eqx.field(static=True, converter=lambda v: _bounds(v))

    def __check_init__(self):
        if len(self.lower) != len(self.upper):
            raise ValueError(
                "Box: `lower` and `upper` must have the same length, found "
                f"{len(self.lower)} and {len(self.upper)}."
            )
        _check_bounds("Box", self.lower, self.upper)

    @property
    def dim(self) -> int:
        return len(self.lower)

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.dim,)

    @property
    def bounds(self) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        return np.array(self.lower), np.array(self.upper)

    @property
    def description(self) -> str:
        return f"the box {listed(self.lower)} to {listed(self.upper)}"


class Interval(AbstractBounded):
    """The interval [a, b] as a source. Points are plain numbers: arrays `(k,)`, or
    `(k, 1)` as a column of a table is.

    Bounds and points may be dates (`datetime64`, pandas, `datetime`): they become seconds
    since 1970-01-01 UTC (those without a time zone count as UTC), durations seconds. That
    is the unit of the source: lambda is in s^3. A float64 tells today's dates apart to
    2e-7 s; for finer times take durations since the first.

    **Example:**

    ```python
    mr.Interval(0, 550)  # ages
    mr.Interval(np.datetime64("2024-05-01"), np.datetime64("2024-05-31"))  # seconds
    ```
    """

    a: float = eqx.field(static=True, converter=lambda v: _bound(v))
    b: float = eqx.field(static=True, converter=lambda v: _bound(v))

    def __check_init__(self):
        _check_bounds("Interval", (self.a,), (self.b,))

    @property
    def dim(self) -> int:
        return 1

    @property
    def point_shape(self) -> tuple[int, ...]:
        return ()

    @property
    def bounds(self) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        return np.array([self.a]), np.array([self.b])

    @property
    def description(self) -> str:
        return f"the interval {listed([self.a, self.b])}"


class Ambient(AbstractSource):
    r"""The neighbourhood of a manifold in its ambient space $\mathbb{R}^s$ as a source:
    energies are integrals over the manifold of *ambient* second derivatives, all s
    directions of them. Stiffer than the manifold itself: bending of it costs, too.

    **Arguments:** `manifold`, any manifold. Points are points of it.

    **Example:**

    ```python
    cloud = mr.PointCloud.from_mesh(trimesh.creation.icosphere(subdivisions=2))
    mr.Ambient(cloud).dim  # 3
    ```
    """

    manifold: AbstractManifold

    def __check_init__(self):
        if not self.manifold.isometric:
            raise ValueError(
                f"Ambient: {type(self.manifold).__name__} has a metric of its own, its "
                "neighbourhood none. Take the manifold itself as the source."
            )

    @property
    def dim(self) -> int:
        return math.prod(self.manifold.point_shape)

    @property
    def point_shape(self) -> tuple[int, ...]:
        return self.manifold.point_shape

    @property
    def sampled(self) -> AbstractManifold:
        return self.manifold

    def chart(self, around: np.ndarray | None) -> Chart | None:
        return self.manifold.chart(around)

    def directions(self, frames, second_forms):
        """All of them, flat."""
        Q, s, _ = frames.shape
        every, flat = np.broadcast_to(np.eye(s), (Q, s, s)), np.zeros((Q, s, s, s))
        return jax.device_put((every, flat))

    def check_points(self, name: str, x: np.ndarray, unit: str = "") -> None:
        self.manifold.check_points(name, x, unit)


def _bounds(values: Numbers) -> tuple[float, ...]:
    numbers, _ = numbers_and_unit("Box", values)
    return tuple(float(v) for v in np.atleast_1d(numbers))


def _bound(value: Numbers) -> float:
    number, _ = numbers_and_unit("Interval", value)
    if number.size != 1:
        raise ValueError(
            f"Interval: a bound is one number, found an array of shape {number.shape}."
        )
    return float(number.reshape(()))


def _check_bounds(name, lower, upper):
    if not (np.all(np.isfinite(lower)) and np.all(np.isfinite(upper))):
        raise ValueError(
            f"{name}: bounds must be finite, found {listed(lower)} and {listed(upper)}."
        )
    if not np.all(np.asarray(lower) < np.asarray(upper)):
        raise ValueError(
            f"{name}: the lower bound must be below the upper one, found {listed(lower)} "
            f"and {listed(upper)}."
        )
