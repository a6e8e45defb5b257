"""Tables on disk: one reader, and where the shared data lie."""

import csv
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import ArrayLike


def read_table(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """The columns of a CSV file by name: float64 where every entry is a number or empty
    (then NaN), strings otherwise. The first line that is neither empty nor starts with
    `#` is the header.

    Raises `FileNotFoundError`, or a `ValueError` that names the file and the line."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file.")
    with path.open(newline="", encoding="utf-8-sig") as file:
        lines = ((i, line) for i, line in enumerate(file, 1) if line.strip())
        numbered = [(i, line) for i, line in lines if not line.startswith("#")]
    rows = list(csv.reader(line for _, line in numbered))
    if len(rows) < 2:
        raise ValueError(f"{path}: needs a header line and at least one row.")
    header = [name.strip() for name in rows[0]]
    for name in header:
        if header.count(name) > 1:
            raise ValueError(f"{path}: the header has the column `{name}` twice.")
    for (line, _), row in zip(numbered, rows, strict=True):
        if len(row) != len(header):
            raise ValueError(
                f"{path}, line {line}: {len(row)} fields, but the header has "
                f"{len(header)} columns."
            )
    columns = zip(*rows[1:], strict=True)
    return dict(zip(header, map(_numbers_or_strings, columns), strict=True))


def _numbers_or_strings(column: tuple[str, ...]) -> np.ndarray:
    try:
        return np.array([float(entry) if entry.strip() else np.nan for entry in column])
    except ValueError:
        return np.array([entry.strip() for entry in column])


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


def unit(vectors: Sequence[Any] | ArrayLike) -> np.ndarray:
    """`vectors` (..., t) scaled to length 1."""
    vectors = np.asarray(vectors, np.float64)
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
