r"""Finite rotations of a plate from its path of poles, without rotation about the pole.

A pole p seen from the plate at an age says where the spin axis was; the rotation that
carries the plate back takes p to the geographic pole Z. Of all that do, that along the
great circle is taken: about the Euler pole $p \times Z / |p \times Z|$ on the equator, 90
degrees from the meridian of p, by the colatitude of p. Palaeolongitude, which poles do not
tell, is fixed by that convention alone."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._input.shown import shown
from ..datasets._tables import latitude_longitude


class Rotations(NamedTuple):
    """From the present to each of q ages; degrees, angles counterclockwise."""

    lat: Float[np.ndarray, " q"]
    lon: Float[np.ndarray, " q"]
    angle: Float[np.ndarray, " q"]


def rotations_to_pole(poles: Float[np.ndarray, "q 3"], south: bool) -> Rotations:
    """`poles`: unit vectors of south poles, or north poles."""
    lat, lon = latitude_longitude(poles)
    lon = lon + 90 if south else lon - 90
    angle = 90 + lat if south else 90 - lat
    return Rotations(np.zeros_like(lat), (lon + 180) % 360 - 180, angle)


def check_plates(plate_id: int, fixed_id: int) -> None:
    if plate_id == fixed_id or min(plate_id, fixed_id) < 0:
        raise ValueError(
            "plate_id, fixed_id: two whole numbers, 0 or more and not the same; found "
            f"{plate_id} and {fixed_id}."
        )


def rotation_lines(
    ages: Float[np.ndarray, " q"],
    rotations: Rotations,
    comments: Sequence[str],
    plate_id: int,
    fixed_id: int,
) -> str:
    """As GPlates' rotation files (PLATES4, `.rot`) have total reconstruction poles: plate,
    age, latitude, longitude, angle, fixed plate, comment."""
    rows = zip(ages, *rotations, comments, strict=True)
    return "".join(
        f"{plate_id:03d} {shown(age):>10} {lat:13.9f} {lon:14.9f} {angle:14.9f} "
        f"{fixed_id:03d} !{comment}\n"
        for age, lat, lon, angle, comment in rows
    )
