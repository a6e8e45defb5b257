"""Apparent polar wander: from poles of one plate to its path."""

from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from .._input.numbers import Numbers, as_numbers
from .._objective.robust import AbstractLoss
from .._selection.chosen_fit import chosen_fit
from .._selection.criteria import CriterionName
from .._selection.noise import Scatter
from .._selection.orders import Order
from .._solver.posterior import Posterior
from .._sources.sources import Interval
from ..datasets._tables import (
    directions,
    first_longitude,
    latitude_longitude,
)
from ..manifolds import Sphere
from ._polarity import opposite
from ._poles import CheckedPoles, Poles, checked
from ._rotations import (
    Rotations,
    check_plates,
    rotation_lines,
    rotations_to_pole,
)

RADIUS = 6371.0088  # of the Earth, km (IUGG)
CM_PER_YEAR = 0.1  # in a km per million years
STEPS = 1.0, 2.0, 5.0
MOST_AGES = 60  # of a path by default
NEAR = 0.1  # of a step: so far beyond the data may an age of the table lie
LEVEL = 0.95

Hemisphere = Literal["north", "south"]


class PolePath(NamedTuple):
    """A path of poles: the fitted map from ages (Ma) to the sphere, and what tables have
    of it. Made by `path`."""

    model: Any
    """The `RegressionMap`: `model(ages)` are unit vectors."""
    posterior: Posterior
    poles: CheckedPoles
    """As they were fitted, of one polarity."""
    flipped: Bool[np.ndarray, " n"]
    """Poles that were turned round."""
    hemisphere: Hemisphere
    """Of which geographic pole it is the path."""
    ages: Float[np.ndarray, " q"]
    """Ma; of the table, unless others are asked for."""
    choice: Any = None
    """How lambda was chosen, a `CrossValidation`; None where it was given."""

    def table(
        self,
        ages: Numbers | None = None,
        *,
        site: tuple[float, float] | None = None,
        level: float = LEVEL,
    ) -> dict[str, Float[np.ndarray, " q"]]:
        """Columns at `ages` (q,), default `self.ages`:

        - `age`, `lat`, `lon` of the path, Ma and degrees.
        - `theta95`: the radius of the circle as large as the ellipse that holds the path
          with the probability `level`; `semi_major`, `semi_minor`, `azimuth` of its longer
          axis: degrees, from north, clockwise.
        - `rate`, `rate_sd`: degrees of arc per million years, with its standard deviation.
        - `cm_per_year`: how fast the plate moved over the mantle (with the least rotation
          that the path allows, none about the pole) at the `site`, its latitude and
          longitude today; without one 90 degrees from the Euler pole, where it is fastest.
        - `motion_azimuth`: where to the pole moves as time goes on, towards younger ages.
        - `euler_lat`, `euler_lon`, `euler_theta95`: the stage pole about which the plate
          turned, counterclockwise as time went on, in its coordinates of today, and the
          radius of its region (180: anywhere).
        - `poles`: how many lie within the window; `effective_poles` and `window` (Myr) as
          of `Posterior.equivalent_kernel`.

        **Raises** ValueError for ages off the path, a site or a level that is none."""
        ages = self._asked(ages)
        region = self.posterior.region(ages, level)
        motion = self.posterior.sphere_motion(ages, level)
        kernel = self.posterior.equivalent_kernel(ages)
        start = first_longitude(self.poles.lon)
        lat, lon = latitude_longitude(region.centre, start)
        euler = np.asarray(motion.euler_pole.centre)
        euler_lat, euler_lon = latitude_longitude(euler, start)
        minor, major = np.degrees(region.semi_axes).T
        inside = np.abs(self.poles.age - ages[:, None]) <= kernel.width[:, None] / 2
        name = f"{100 * level:g}"
        return {
            "age": ages,
            "lat": lat,
            "lon": lon,
            f"theta{name}": region.theta95,
            "semi_major": major,
            "semi_minor": minor,
            "azimuth": region.azimuth,
            "rate": np.degrees(motion.speed),
            "rate_sd": np.degrees(motion.speed_deviation),
            "cm_per_year": motion.speed * RADIUS * CM_PER_YEAR * _lever(euler, site),
            "motion_azimuth": (np.asarray(motion.azimuth) + 180) % 360,
            "euler_lat": euler_lat,
            "euler_lon": euler_lon,
            f"euler_theta{name}": np.minimum(motion.euler_pole.theta95, 180.0),
            "poles": inside.sum(1).astype(float),
            "effective_poles": kernel.number,
            "window": kernel.width,
        }

    def rotations(self, ages: Numbers | None = None) -> Rotations:
        """Euler poles and angles that carry the plate from today to each of the `ages`
        (default `self.ages`): along the great circle from the path to the geographic pole,
        without rotation about the pole (see `manireg.apps._rotations`)."""
        poles = np.asarray(self.model(self._asked(ages)))
        return rotations_to_pole(poles, self.hemisphere == "south")

    def gplates(
        self, ages: Numbers | None = None, *, plate_id: int = 1, fixed_id: int = 0
    ) -> str:
        """The rotations as the text of a GPlates rotation file (`.rot`), of the plate
        `plate_id` to the spin axis, `fixed_id`."""
        check_plates(plate_id, fixed_id)
        ages = np.sort(self._asked(ages))
        theta = self.posterior.region(ages, LEVEL).theta95
        comments = [f"path of {self.hemisphere} poles, Theta95 {t:.1f}" for t in theta]
        parts = ages, self.rotations(ages), comments
        return rotation_lines(*parts, plate_id, fixed_id)

    def picture(
        self, *, projection: Literal["globe", "polar"] = "globe", level: float = LEVEL
    ) -> Any:
        """A figure for print: poles with A95 circles, coloured by age, the path and where
        it is with the probability `level`; below its rate. `projection`: the globe as the
        eye sees it, or a hemisphere about the geographic pole, equal-area."""
        from ._path_picture import draw

        return draw(self, projection, level)

    def _asked(self, ages: Numbers | None) -> Float[np.ndarray, " q"]:
        return self.ages if ages is None else np.atleast_1d(as_numbers("ages", ages))


def path(
    poles: Poles,
    *,
    ages: Numbers | None = None,
    age_step: float | None = None,
    flip: Literal["auto", "none"] = "auto",
    hemisphere: Hemisphere | None = None,
    missing_age_sigma: float = 0.0,
    lam: Numbers | None = None,
    wavelength: Numbers | None = None,
    criterion: CriterionName = "reml",
    scatter: Scatter = "additive",
    loss: AbstractLoss | str = "squared",
    order: Order = 2,
    progress: bool = True,
) -> PolePath:
    """The path of the palaeomagnetic poles of one plate: `mr.fit` from an `Interval` of
    ages to `Sphere(2)`, with the precision of each pole by its A95 (see `from_a95`), the
    scatter beyond that found, ages within their ranges or errors (latent), and lambda by
    restricted likelihood. `manireg path` writes the same numbers.

    **Arguments:**

    - `poles`: of any order of age. A pole without A95 (NaN, 0) has the median of the
      others; without any, all count alike and only their scatter is found.
    - `ages`: of the table, Ma; the path goes as far. Default multiples of `age_step`
      within the poles, the least of 1, 2, 5 times a power of ten that gives at most 60.
    - `flip`: `"auto"` (default) turns poles round that lie more than 90 degrees from the
      path around them (see `manireg.apps._polarity`); `"none"` takes all as they are.
    - `hemisphere`: whether these are `"north"` or `"south"` poles, which `rotations` need;
      default what is nearer to the youngest end of the path.
    - `missing_age_sigma`: standard deviation, Ma, of ages that have neither a range nor
      one of their own; default 0, exact.
    - `lam`, `wavelength` (Myr), `criterion`, `scatter`, `loss`, `order`: as in `fit`.
    - `progress`: show progress bars.

    **Returns** a `PolePath`: `.table()`, `.rotations()`, `.gplates()`, `.picture()`.

    **Raises** ValueError for columns that are not as in `Poles`, and as `fit` does.

    **Example:**

        data = mr.datasets.palaeomagnetic_poles("gondwana")
        lat, lon = ...  # degrees
        path = mr.apps.path(mr.apps.Poles(data.ages, lat, lon, a95=data.a95))
        path.table()["theta95"]
    """
    if flip not in ("auto", "none"):
        raise ValueError(f"flip: expected 'auto' or 'none', found {flip!r}.")
    if hemisphere not in (None, "north", "south"):
        raise ValueError(f"hemisphere: 'north' or 'south', found {hemisphere!r}.")
    data = checked(poles, missing_age_sigma)
    turned = np.zeros(len(data.age), bool)
    if flip == "auto":
        turned = opposite(data.age, data.directions)
    signs = np.where(turned, -1.0, 1.0)[:, None]
    data = data._replace(directions=signs * data.directions)
    if ages is None:
        ages = _ages(data.age, age_step)
    ages = np.atleast_1d(as_numbers("ages", ages))
    bounds = np.array([*data.bounds, ages.min(), ages.max()])
    source = Interval(bounds.min(), bounds.max())
    noise = {**data.of_noise, "loss": loss, "order": order}
    options = {"criterion": criterion, "wavelength": wavelength}
    if data.of_ages or lam is None and wavelength is None:
        options |= {"progress": progress}  # one fit has none to show
    problem = source, Sphere(2), data.age, data.directions
    model, choice = chosen_fit(*problem, lam, noise, scatter, **data.of_ages, **options)
    # a lambda that is given is known
    posterior = model.posterior("known" if choice is None else "auto")
    if hemisphere is None:
        first = np.asarray(model(np.array([data.age.min()])))[0, 2]
        hemisphere = "north" if first >= 0 else "south"
    return PolePath(model, posterior, data, turned, hemisphere, ages, choice)


def _ages(age: Float[np.ndarray, " n"], step: float | None) -> np.ndarray:
    """Multiples of the step, within the data or hardly beyond."""
    low, high = float(age.min()), float(age.max())
    if step is None:
        least = max(high - low, 1e-6) / MOST_AGES
        power = float(10.0 ** np.floor(np.log10(least)))
        step = next((s * power for s in STEPS if s * power >= least), 10.0 * power)
    if not 0 < step < np.inf:
        raise ValueError(f"age_step: must be positive, in Myr, found {step}.")
    first, last = np.ceil(low / step - NEAR), np.floor(high / step + NEAR)
    if last < first:
        raise ValueError(
            f"age_step: no multiple of {step:g} lies within {low:g} to {high:g} Ma; give "
            "a smaller step, or ages."
        )
    # products of whole numbers: no age is 59.99999
    per = 1 / step
    whole = np.arange(first, last + 1) + 0.0  # no -0
    return (
        whole / round(per) if step < 1 and np.isclose(per, round(per)) else whole * step
    )


def _lever(euler: Float[np.ndarray, "q 3"], site: tuple[float, float] | None):
    """The sine of the angle between them."""
    if site is None:
        return np.ones(len(euler))
    check_site(site)
    return np.linalg.norm(np.cross(euler, directions(*site)), axis=1)


def check_site(site: tuple[float, float]) -> None:
    lat, lon = site
    if not (abs(lat) <= 90 and abs(lon) <= 360):
        raise ValueError(
            f"site: a latitude and a longitude in degrees, found {lat:g}, {lon:g}."
        )
