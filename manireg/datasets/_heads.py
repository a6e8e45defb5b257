"""Heads with known dense correspondence: the paper's second experiment on open data."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from ._tables import data_folder

NAMES = ("ict", "makehuman")
TARGETS = 10


class HeadPair(NamedTuple):
    """A mean head, one of ten others, and where each vertex of the first belongs on the
    second (millimetres; x to the head's left, y up, z forward)."""

    source: trimesh.Trimesh
    target: trimesh.Trimesh
    source_landmarks: Int[np.ndarray, " l"]
    """Vertices of the source."""
    target_landmarks: Float[np.ndarray, "l 3"]
    truth: Float[np.ndarray, "n 3"]
    """For scoring only."""
    area: Float[np.ndarray, " n"]
    """Of each vertex, the weights of means."""
    interior: Bool[np.ndarray, " n"]
    """From brows to chin."""
    near_landmarks: Bool[np.ndarray, " n"]
    """Within 40 mm of a landmark; the rest is extrapolation."""


def heads(
    name: str = "ict", target: int = 0, landmarks: int = 55, source: int | None = None
) -> HeadPair:
    """The mean head, or head 0..9 if it is the `source`, and target 0..9 of `"ict"` (ICT
    Face Model Light, MIT) or `"makehuman"` (CC0), with 55 or 20 landmarks.

    **Raises** FileNotFoundError where the shared data are missing, ValueError for a head
    that does not exist."""
    heads = range(TARGETS)
    known = name in NAMES and target in heads and source in (None, *heads)
    if not known or landmarks not in (55, 20):
        raise ValueError(
            f"heads: expected name {' or '.join(NAMES)}, target and source 0 to "
            f"{TARGETS - 1}, 55 or 20 landmarks; found {name!r}, {target!r}, {source!r}, "
            f"{landmarks!r}."
        )
    arrays = _arrays(name)
    of_target = {
        key: arrays[f"target{target:02d}_{key}"] for key in ("vertices", "faces")
    }
    chosen = arrays["landmarks_sparse"] if landmarks == 20 else slice(None)
    vertices = arrays["vertices"]
    if source is not None:
        vertices = arrays["ground_truth"][source]
    return HeadPair(
        _mesh(vertices, arrays["faces"]),
        _mesh(**of_target),
        arrays["landmarks"].astype(int)[chosen],
        arrays["target_landmarks"][target].astype(float)[chosen],
        arrays["ground_truth"][target].astype(float),
        arrays["vertex_area"].astype(float),
        arrays["interior"],
        arrays["near_landmarks"],
    )


@lru_cache(maxsize=1)
def _arrays(name: str) -> dict[str, np.ndarray]:
    file = data_folder() / f"{name}_heads.npz"
    if not file.is_file():
        raise FileNotFoundError(
            f"{file} is missing. Set the environment variable MANIREG_DATA to the folder "
            "that has it."
        )
    with np.load(file) as arrays:
        return dict(arrays)


def _mesh(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices.astype(float), faces, process=False)
