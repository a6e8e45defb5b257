"""Two surfaces with pairs of places on them, as fits take them."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .._input.numbers import Numbers, as_numbers
from .._programs.sizes import power_of_four
from ..manifolds import PointCloud
from ..manifolds._scans.surface import Surface
from .given import on_piece, one_piece
from .landmark_pairs import LandmarkPairs

FEWEST_POINTS = 8192


class Onto(NamedTuple):
    """A target."""

    cloud: PointCloud
    padded: PointCloud
    """With points without weight: similar targets share compiled programs."""


class Scans(NamedTuple):
    pieces: dict[str, Surface]
    """What each geometry takes of the source."""
    x: dict[str, Float[np.ndarray, "l 3"]]
    """Landmarks on these."""
    onto: Onto
    y: Float[np.ndarray, "l 3"]
    sigma: np.ndarray | None
    precision: np.ndarray | None

    def among(self, kept: Int[np.ndarray, " i"]) -> "Scans":
        """With these landmarks only."""
        part = lambda a: a[kept] if np.ndim(a) else a
        return self._replace(
            x={of: part(x) for of, x in self.x.items()},
            y=part(self.y),
            sigma=part(self.sigma),
            precision=part(self.precision),
        )


def scans_of(
    source: Surface,
    target: Surface,
    pairs: LandmarkPairs,
    geometries: Iterable[str],
    sigma: Numbers | None = None,
    precision: Numbers | None = None,
) -> Scans:
    pieces = {of: source if of == "ambient" else one_piece(source) for of in geometries}
    places = {
        of: on_piece(piece, source, pairs.x, pairs.names)
        for of, piece in pieces.items()
    }
    size = power_of_four(len(target.cloud.points), least=FEWEST_POINTS)
    onto = Onto(target.cloud, target.cloud.padded(size))
    of_pairs = (_of_pairs(a, pairs.numbers) for a in (sigma, precision))
    return Scans(pieces, places, onto, pairs.y, *of_pairs)


def _of_pairs(value: Numbers | None, index: list[int]) -> np.ndarray | None:
    """What is given for each landmark of the source, for those in pairs."""
    if value is None:
        return None
    array = as_numbers("sigma, precision", value)
    whole = array.ndim > 0 and len(array) > max(index)
    return array[index] if whole else array
