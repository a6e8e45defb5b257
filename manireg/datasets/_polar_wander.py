"""Apparent polar wander: the bundled table, age -> S^2 with known precision."""

from collections.abc import Sequence
from importlib.resources import as_file, files
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float

from ._tables import directions, read_table, rows_of

PLATES = (
    "australia",
    "europe",
    "india",
    "north_america",
    "south_africa",
    "south_africa_alt",
    "south_america",
)


class PolarWander(NamedTuple):
    """Where the south pole stood, seen from one plate."""

    references = ("torsvik2008global",)

    ages: Float[np.ndarray, " n"]
    """Million years before present."""
    directions: Float[np.ndarray, "n 3"]
    """Unit vectors."""
    a95: Float[np.ndarray, " n"]
    """Radius of the 95 % confidence cone of each mean pole, degrees."""
    weights: Float[np.ndarray, " n"]
    """Precision weights with mean 1, see `a95_weights`."""
    plate: str


def polar_wander(plate: str = "india") -> PolarWander:
    """The running-mean apparent polar wander path of one plate (see
    `polar_wander_plates`), 0 to 320 million years at steps of 10: Torsvik et al. 2008
    (Rev. Geophys. 46, RG3004), from pmagpy 4.5.2 (BSD-3-Clause, see `NOTICE`).

    **Example:**

    ```python
    data = mr.datasets.polar_wander("india")
    data.ages, data.directions, data.a95  # Ma, unit vectors, degrees
    ```
    """
    table = rows_of(_bundled(), "plate", plate)
    return PolarWander(
        ages=table["age_ma"],
        directions=directions(table["pole_lat_deg"], table["pole_lon_deg"]),
        a95=table["a95_deg"],
        weights=a95_weights(table["a95_deg"]),
        plate=plate,
    )


def polar_wander_plates() -> tuple[str, ...]:
    """The names that `polar_wander` knows."""
    return PLATES


def a95_weights(a95: Sequence[float] | ArrayLike) -> Float[np.ndarray, " n"]:
    r"""Weights $w_i \propto 1/\sigma_i^2$ with mean 1 from 95 % confidence radii (n,).

    The mean of N directions of concentration kappa has standard deviation
    $\sigma = 1/\sqrt{\kappa N}$ in each tangent direction, and
    $\alpha_{95} = 140°/\sqrt{\kappa N}$, so $\sigma = \alpha_{95} / 140°$ and the unit
    of `a95` drops out. A radius that is zero or missing (NaN, masked) says nothing about
    the precision: it counts as the median of the others; with no others all weights are 1.
    """
    a95 = np.ma.filled(np.ma.asarray(a95).astype(float), np.nan)
    known = np.isfinite(a95) & (a95 > 0)
    if (a95 < 0).any():
        raise ValueError(
            f"`a95` has negative entries, the first at index {np.argmax(a95 < 0)}."
        )
    if not known.any():
        return np.ones_like(a95)
    weights = 1 / np.where(known, a95, np.median(a95[known])) ** 2
    return weights / weights.mean()


def _bundled() -> dict[str, np.ndarray]:
    with as_file(files("manireg.datasets") / "s2_polar_wander_torsvik2008.csv") as path:
        return read_table(path)
