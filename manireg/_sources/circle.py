"""Periodic inputs: hours of a day, phases of a cycle, compass bearings."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._input.numbers import Numbers, as_numbers
from .._input.shown import shown
from .._source import AbstractSource, Chart
from ..manifolds import Sphere


class Circle(AbstractSource):
    r"""A periodic interval as a source: x is a plain number on any branch, and x and
    x + `period` are the same input. Inside it is the circle of that circumference in
    $\mathbb{R}^2$, so lengths are those of x, and lambda has the unit of `period`$^3$.

    **Arguments:** `period` (default $2\pi$), a positive number: 24 for hours, 360 for
    degrees. Points are arrays `(k,)`, or `(k, 1)` as a column of a table is.

    **Raises** ValueError for a period that is not positive and finite, and for dates, as
    period or as x: give the hours, or the days of the year. A circle as a *target* is
    `Sphere(1)`.

    **Example:** the wind, a direction, over the hours of a day; hour 25 is hour 1.

    ```python
    hours = np.arange(0, 48, 3.0)
    angles = np.sin(2 * np.pi * hours / 24)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    model = mr.fit(mr.Circle(24), mr.Sphere(1), hours, directions, lam=10.0)
    jnp.abs(model(25.0) - model(1.0)).max() < 1e-9  # True
    ```
    """

    period: float = eqx.field(
        static=True, default=2 * np.pi, converter=lambda v: _period(v)
    )

    def __check_init__(self):
        if not (np.isfinite(self.period) and self.period > 0):
            raise ValueError(
                "Circle: `period` must be positive and finite, found "
                f"{shown(self.period)}."
            )

    @property
    def dim(self) -> int:
        return 1

    @property
    def point_shape(self) -> tuple[int, ...]:
        return ()

    @property
    def _image(self) -> Sphere:
        return Sphere(1, self.period / (2 * np.pi))

    def to_ambient(self, x: Float[Any, " k"]) -> Float[Any, "k 2"]:
        r"""$r (\cos(x/r), \sin(x/r))$, $2\pi r$ the period."""
        numpy = jnp if isinstance(x, jax.Array) else np  # that of x
        angle = 2 * np.pi * numpy.mod(x, self.period) / self.period
        radius = self.period / (2 * np.pi)
        return radius * numpy.stack([numpy.cos(angle), numpy.sin(angle)], axis=-1)

    def from_ambient(self, p: Float[Any, "k 2"]) -> Float[Array, " k"]:
        """On the branch from -`period`/2 to `period`/2."""
        return jnp.arctan2(p[:, 1], p[:, 0]) * self._image.radius

    def chart(self, around: np.ndarray | None) -> Chart | None:
        return self._image.chart(around)

    def squared_distances(
        self, p: Float[Array, "a 2"], q: Float[Array, "b 2"]
    ) -> Float[Array, "a b"]:
        """Of the arc."""
        return self._image.squared_distances(p, q)


def _period(value: Numbers) -> float:
    number = as_numbers("Circle: `period`", value)
    if number.size != 1:
        raise ValueError(
            f"Circle: `period` is one number, found an array of shape {number.shape}."
        )
    return float(number.reshape(()))
