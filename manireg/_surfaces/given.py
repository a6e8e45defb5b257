"""Surfaces as `register` takes them."""

import re
import warnings

import numpy as np
from jaxtyping import Float

from .._sources.checks import check_landmarks
from ..manifolds._scans.surface import Surface, SurfaceLike, load_surface


def given_surface(name: str, surface: SurfaceLike) -> Surface:
    """`load_surface`, with what it says under the name of the argument."""
    try:
        found = load_surface(surface)
    except ValueError as error:
        message = re.sub("^(mesh|surface|points):", f"{name}:", str(error))
        raise ValueError(message) from error
    if found is not surface and found.report.notable:
        warnings.warn(f"{name}: {found.report.notable}.", stacklevel=3)
    return found


def one_piece(surface: Surface) -> Surface:
    """What the intrinsic energy takes."""
    piece = surface.largest()
    if piece is not surface:
        warnings.warn(
            "source: the intrinsic energy takes its largest component alone, of "
            f"{surface.components}; vertices of the others go with the nearest of it.",
            stacklevel=4,
        )
    return piece


def on_piece(
    piece: Surface, surface: Surface, x, names: tuple[str, ...]
) -> Float[np.ndarray, "l 3"]:
    """Landmarks of the surface as points of its piece."""
    if piece is surface:
        return x
    hint = (
        "It is not on the largest component; leave it out, or take the ambient energy."
    )
    return check_landmarks("source_landmarks", piece.cloud, x, names, hint)
