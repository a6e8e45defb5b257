"""Single palaeomagnetic poles: the bundled table, age -> S^2 with a circle of confidence
each."""

from importlib.resources import as_file, files
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from ._tables import directions, read_table

PLATES = {  # and how many poles they have
    "gondwana": 194,
    "amazonia": 23,
    "arabia": 4,
    "australia": 25,
    "colorado": 21,
    "east_antarctica": 18,
    "east_gondwana": 23,
    "europe": 168,
    "greenland": 13,
    "madagascar": 14,
    "meseta": 10,
    "north_america": 184,
    "northeast_africa": 22,
    "northwest_africa": 26,
    "parana": 6,
    "patagonia": 6,
    "somalia": 13,
    "southern_africa": 18,
}


class PalaeomagneticPoles(NamedTuple):
    """South poles, each of the rocks of one study, in the coordinates of South Africa."""

    references = ("torsvik2012phanerozoic",)

    ages: Float[np.ndarray, " n"]
    """Million years before present, ascending."""
    directions: Float[np.ndarray, "n 3"]
    """Unit vectors."""
    a95: Float[np.ndarray, " n"]
    """Radius of the 95 % confidence cone of each pole, degrees; NaN where the table has
    none."""
    plates: Shaped[np.ndarray, " n"]
    """The plate of each, a name of `palaeomagnetic_plates`."""


def palaeomagnetic_poles(plate: str | None = None) -> PalaeomagneticPoles:
    """Poles of the last 550 million years: all 594, or those of a plate (see
    `palaeomagnetic_plates`); `"gondwana"` are the 194 of the twelve plates that were
    Gondwana. They were rotated as the plates moved, so that poles of one age would agree
    but for their errors.

    ```python
    poles = mr.datasets.palaeomagnetic_poles("gondwana")
    sigma = mr.from_a95(poles.a95)
    ```

    Torsvik et al. 2012 (Earth-Sci. Rev. 114, 325), through SphereUDE-examples
    (BSD-3-Clause, see `NOTICE`).

    **Raises** ValueError for a plate that is not there."""
    table = _bundled()
    plates = np.char.lower(table["plate"])
    if plate == "gondwana":
        keep = table["gondwana"] == 1
    else:
        keep = np.full(len(plates), True) if plate is None else plates == plate
    if not keep.any():
        there = ", ".join(palaeomagnetic_plates())
        raise ValueError(f"No plate {plate!r}; there are: {there}.")
    keep = np.flatnonzero(keep)
    keep = keep[np.argsort(table["age"][keep], kind="stable")]
    a95 = table["a95"][keep]
    return PalaeomagneticPoles(
        ages=table["age"][keep],
        directions=directions(table["lat"][keep], table["lon"][keep]),
        a95=np.where(a95 > 0, a95, np.nan),
        plates=plates[keep],
    )


def palaeomagnetic_plates(least: int = 1) -> tuple[str, ...]:
    """The names that `palaeomagnetic_poles` knows, of plates with `least` poles or more;
    `"gondwana"` first."""
    return tuple(name for name, count in PLATES.items() if count >= least)


def _bundled() -> dict[str, np.ndarray]:
    with as_file(files("manireg.datasets") / "s2_poles_torsvik2012.csv") as path:
        return read_table(path)
