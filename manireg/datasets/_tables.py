"""Tables on disk: one reader, and where the shared data lie."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import ArrayLike

from ._entries import BadEntry, hemispheres, numerals
from ._text_tables import read_text_table


def read_table(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """The columns of a table by name: float64 where every entry is a number or missing
    (then NaN), strings otherwise.

    Fields are separated by `,`, `;`, tabs, `|` or spaces; the text is UTF-8, UTF-16 or
    Windows-1252. The first line that is neither empty nor starts with `#` or `%` is the
    header, or the comment above it where the names stand there. Missing is what is
    empty, `NA`, `nan`, `null`, `-` and the like. Numbers may have decimal commas (where
    that is clear), degree signs and, in columns of latitude or longitude by name,
    hemispheres: `12.5S` is -12.5.

    Raises `FileNotFoundError`, or a `ValueError` that names the file and the line."""
    table = read_text_table(Path(path))

    def converted(name: str, entries: list[str]) -> np.ndarray:
        try:
            texts = numerals(entries, table.marks, hemispheres(name))
        except BadEntry:
            return np.array(entries)
        return np.array([float(text) if text else np.nan for text in texts])

    return {name: converted(name, entries) for name, entries in table.columns.items()}


def data_folder() -> Path:
    """Folder of the shared data: the environment variable `MANIREG_DATA` if it is set,
    otherwise `shared/data` in the nearest folder above the working directory.

    Raises `FileNotFoundError` where there is none."""
    if chosen := os.environ.get("MANIREG_DATA"):
        candidates = [Path(chosen)]
    else:
        candidates = [folder / "shared" / "data" for folder in Path.cwd().parents]
    for folder in candidates:
        if folder.is_dir():
            return folder
    raise FileNotFoundError(
        f"The shared data are not at {candidates[0]}: set the environment variable "
        "MANIREG_DATA to their folder, or pass `path=`, the file itself."
    )


def find_table(name: str, path: str | os.PathLike[str] | None) -> Path:
    """`path` if given, otherwise the table `name` of the shared data."""
    file = Path(path) if path is not None else data_folder() / "tables" / name
    if not file.is_file():
        raise FileNotFoundError(
            f"{file} is missing. Set the environment variable MANIREG_DATA to the "
            f"folder that has tables/{name}, or pass `path=`, the file itself."
        )
    return file


def rows_of(table: dict[str, np.ndarray], column: str, value: str):
    """Rows of `table` where `column` is `value`; a `ValueError` names the choices."""
    keep = table[column] == value
    if not keep.any():
        choices = ", ".join(np.unique(table[column]))
        raise ValueError(f"No {column} {value!r}; there are: {choices}.")
    return {name: entries[keep] for name, entries in table.items()}


def directions(latitude: ArrayLike, longitude: ArrayLike) -> np.ndarray:
    """Unit vectors (n, 3) from latitude and longitude in degrees."""
    lat, lon = np.radians(np.asarray(latitude)), np.radians(np.asarray(longitude))
    x, y = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon)
    return np.stack([x, y, np.sin(lat)], axis=-1)


def latitude_longitude(
    vectors: ArrayLike, start: float = -180.0
) -> tuple[np.ndarray, np.ndarray]:
    """Degrees of vectors (..., 3), longitudes in [start, start + 360)."""
    x, y, z = np.moveaxis(np.asarray(vectors), -1, 0)
    return np.degrees(np.arctan2(z, np.hypot(x, y))), degrees_from(start, x, y)


def degrees_from(start: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The angles of points of the plane, in [start, start + 360)."""
    return (np.degrees(np.arctan2(y, x)) - start) % 360 + start


def first_longitude(degrees: np.ndarray) -> float:
    """Where the longitudes of a table begin."""
    return 0.0 if np.min(degrees) >= 0 else -180.0


def unit(vectors: Sequence[Any] | ArrayLike) -> np.ndarray:
    """`vectors` (..., t) scaled to length 1."""
    vectors = np.asarray(vectors, np.float64)
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
