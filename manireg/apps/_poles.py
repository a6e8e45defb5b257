"""Palaeomagnetic poles as tables have them, and as `fit` takes them."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from .._input.directional import from_a95
from .._input.numbers import Numbers, as_numbers
from .._input.shown import shown
from ..datasets._tables import directions

OLDEST = 4600.0  # million years: before there was nothing to be magnetised
REACH = 3.0  # standard deviations that an age may be off


class Poles(NamedTuple):
    """Poles of one plate, `(n,)` each, NaN where a table has nothing. Ages are in millions
    of years (Ma), the rest in degrees.

        mr.apps.Poles(age, lat, lon, a95=a95, age_min=low, age_max=high)
    """

    age: Any
    lat: Any
    lon: Any
    a95: Any = None
    """Radii of 95 % confidence; see `mr.a95_of`."""
    age_min: Any = None
    """With `age_max`: the age may be anywhere between (uniform)."""
    age_max: Any = None
    age_sigma: Any = None
    """Or its standard deviation (normal), which counts where there is a range, too."""


class CheckedPoles(NamedTuple):
    """The same as arrays, with everything known."""

    age: Float[np.ndarray, " n"]
    directions: Float[np.ndarray, "n 3"]
    lon: Float[np.ndarray, " n"]
    a95: Float[np.ndarray, " n"] | None
    """None where no pole has any."""
    assumed: Bool[np.ndarray, " n"]
    """Of which it is the median of the others."""
    age_min: Float[np.ndarray, " n"]
    """NaN where the age has a standard deviation."""
    age_max: Float[np.ndarray, " n"]
    age_sigma: Float[np.ndarray, " n"]
    """NaN where it has a range; 0 where it is exact."""
    alone: Bool[np.ndarray, " n"]
    """Of which neither was known."""
    moved: Bool[np.ndarray, " n"]
    """Whose age lay outside its range, and now is at its nearer end."""

    @property
    def bounds(self) -> tuple[float, float]:
        """Of all ages that any pole may have."""
        reach = REACH * np.nan_to_num(self.age_sigma)
        low = np.fmin(self.age_min, np.maximum(self.age - reach, 0.0))
        high = np.fmax(self.age_max, self.age + reach)
        return float(low.min()), float(high.max())

    @property
    def of_noise(self) -> dict[str, np.ndarray]:
        """Arguments of `fit`."""
        return {} if self.a95 is None else {"sigma": np.asarray(from_a95(self.a95))}

    @property
    def of_ages(self) -> dict[str, np.ndarray]:
        """Arguments of `fit`; none where all ages are exact."""
        if np.all(self.age_sigma == 0):
            return {}
        if np.all(np.isfinite(self.age_sigma)):
            return {"x_sigma": self.age_sigma}
        ends = {"x_min": self.age_min, "x_max": self.age_max}
        if np.all(np.isnan(self.age_sigma)):
            return ends
        return ends | {"x_sigma": self.age_sigma}


def checked(poles: Poles, missing_age_sigma: float) -> CheckedPoles:
    """**Raises** ValueError that names the index of the first wrong pole."""
    n = np.size(as_numbers("age", poles.age))
    column = lambda name: _column(name, getattr(poles, name), n)
    age, lat, lon, a95 = map(column, ("age", "lat", "lon", "a95"))
    low, high, sigma = map(column, ("age_min", "age_max", "age_sigma"))
    if not 0 <= missing_age_sigma < np.inf:
        raise ValueError(
            "missing_age_sigma: a standard deviation in Ma, 0 or more, found "
            f"{missing_age_sigma}."
        )
    one = np.isnan(low) != np.isnan(high)
    _refuse("age_min, age_max", np.fmin(low, high), one, "give both ends of a range")
    _refuse("age_min", low, low > high, "must not exceed age_max; exchange them")
    age = np.where(np.isnan(age), (low + high) / 2, age)
    _refuse("age", age, np.isnan(age), "missing; give an age or a range")
    for name, values in (("age", age), ("age_min", low)):
        _refuse(name, values, values < 0, "must not be negative: Ma before present")
    oldest = np.fmax(age, high)
    _refuse("age", oldest, oldest > OLDEST, "older than the Earth; give ages in Ma")
    _refuse("lat", lat, ~(np.abs(lat) <= 90), "must lie in [-90, 90] degrees")
    _refuse("lon", lon, ~np.isfinite(lon), "must be finite")
    _refuse("a95", a95, a95 < 0, "must not be negative")
    _refuse("age_sigma", sigma, sigma < 0, "must not be negative")
    normal = np.isfinite(sigma)
    alone = ~normal & np.isnan(low)
    low, high = (np.where(normal, np.nan, end) for end in (low, high))
    inside = np.fmin(np.fmax(age, low), high)
    assumed = ~(a95 > 0)
    if np.all(assumed):
        a95 = None
    else:
        a95 = np.where(assumed, np.median(a95[~assumed]), a95)
    return CheckedPoles(
        age=inside,
        directions=directions(lat, lon),
        lon=lon,
        a95=a95,
        assumed=assumed,
        age_min=low,
        age_max=high,
        age_sigma=np.where(alone, missing_age_sigma, sigma),
        alone=alone,
        moved=inside != age,
    )


def _column(name: str, values: Numbers | None, n: int) -> Float[np.ndarray, " n"]:
    if values is None:
        return np.full(n, np.nan)
    numbers = as_numbers(name, values)
    if numbers.shape != (n,):
        raise ValueError(
            f"{name}: expected shape ({n},), one for each age, found {numbers.shape}."
        )
    return numbers


def _refuse(name: str, values: np.ndarray, bad: np.ndarray, demand: str) -> None:
    if bad.any():
        i = int(np.argmax(bad))
        raise ValueError(
            f"{name}: {demand} (found {shown(values[i])} at index {i}; {bad.sum()} of "
            f"{len(bad)} poles)."
        )
