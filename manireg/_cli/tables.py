"""Between the columns of a table and the points of a manifold, for the command line."""

import csv
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from .. import manifolds
from .._input.shown import shown
from ..datasets._tables import (
    degrees_from,
    directions,
    first_longitude,
    latitude_longitude,
    unit,
)
from ..datasets._text_tables import TextTable
from .columns import find, numbers


class TargetName(StrEnum):
    sphere = "sphere"
    rotations = "rotations"
    circle = "circle"
    euclidean = "euclidean"


class Target(NamedTuple):
    """A target manifold and how tables write its points."""

    manifold: manifolds.AbstractManifold
    points: np.ndarray
    """The data, `(k, *point_shape)`."""
    columns: tuple[str, ...]
    decode: Callable[[np.ndarray], np.ndarray]
    """Points to the columns (n, len(columns))."""
    degrees: float | None
    """Degrees of turn per unit of distance on the manifold; None where it has none."""


def read_target(
    name: TargetName, table: TextTable, outputs: list[str], lat_lon: bool
) -> Target:
    """The target `name` with the data in the columns `outputs` of `table`."""
    option = "--lat-lon" if lat_lon else "--output"
    if lat_lon and name != TargetName.sphere:
        raise ValueError("--lat-lon is for --target sphere; use --output.")
    if lat_lon and len(outputs) != 2:
        raise ValueError(f"--lat-lon takes two columns, found {len(outputs)}.")
    values = numbers(table, outputs, option, ("NS", "EW") if lat_lon else None)
    read = {
        TargetName.sphere: _lat_lon if lat_lon else _sphere,
        TargetName.rotations: _rotations,
        TargetName.circle: _circle,
        TargetName.euclidean: _euclidean,
    }
    columns = tuple(find(table, column, option) for column in outputs)
    return read[name](values, columns, table)


def _sphere(values: np.ndarray, columns: tuple[str, ...], table: TextTable) -> Target:
    if len(columns) < 2:
        raise ValueError("--target sphere takes unit vectors: two columns or more.")
    points = _unit(
        values, "unit vectors; for latitude and longitude use --lat-lon", table
    )
    sphere = manifolds.Sphere(len(columns) - 1)
    return Target(sphere, points, columns, np.asarray, np.degrees(1.0))


def _lat_lon(values: np.ndarray, columns: tuple[str, ...], table: TextTable) -> Target:
    beyond = np.flatnonzero(np.abs(values[:, 0]) > 90)
    if beyond.size:
        raise ValueError(
            f"{table.path}: latitude `{columns[0]}` leaves [-90, 90] degrees. Give "
            f"--lat-lon as latitude,longitude (found {shown(values[beyond[0], 0])} in "
            f"{table.where(int(beyond[0]))})."
        )
    points = directions(*values.T)
    start = first_longitude(values[:, 1])

    def decode(p: np.ndarray) -> np.ndarray:
        return np.stack(latitude_longitude(p, start), axis=-1)

    return Target(manifolds.Sphere(2), points, columns, decode, np.degrees(1.0))


def _circle(values: np.ndarray, columns: tuple[str, ...], table: TextTable) -> Target:
    if len(columns) != 1:
        raise ValueError("--target circle takes one column, an angle in degrees.")
    angle, start = np.radians(values[:, 0]), first_longitude(values[:, 0])
    points = np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    def decode(p: np.ndarray) -> np.ndarray:
        return degrees_from(start, p[:, 0], p[:, 1])[:, None]

    return Target(manifolds.Sphere(1), points, columns, decode, np.degrees(1.0))


def _rotations(
    values: np.ndarray, columns: tuple[str, ...], table: TextTable
) -> Target:
    degrees = np.degrees(1 / np.sqrt(2))
    so3 = manifolds.SpecialOrthogonal(3)
    if len(columns) == 4:
        quaternions = _unit(values, "unit quaternions w,x,y,z", table)
        points = Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
        return Target(so3, points, columns, _quaternions, degrees)
    if len(columns) != 9:
        raise ValueError(
            "--target rotations takes four columns (quaternion w,x,y,z) or nine "
            f"(matrix, row by row), found {len(columns)}."
        )
    matrices = values.reshape(-1, 3, 3)
    points = np.asarray(so3.project(jnp.asarray(matrices)))
    gap = np.abs(points - matrices).max((1, 2))
    _close(gap, "rotation matrices, row by row", table)
    return Target(so3, points, columns, lambda p: p.reshape(-1, 9), degrees)


def _euclidean(
    values: np.ndarray, columns: tuple[str, ...], table: TextTable
) -> Target:
    space = manifolds.Euclidean(len(columns))
    return Target(space, values, columns, np.asarray, None)


def _quaternions(p: np.ndarray) -> np.ndarray:
    """w,x,y,z, with the sign that continues the row before."""
    q = Rotation.from_matrix(p).as_quat(canonical=True, scalar_first=True)
    turns = np.where((q[1:] * q[:-1]).sum(-1) < 0, -1.0, 1.0)
    return q * np.concatenate([[1.0], np.cumprod(turns)])[:, None]


def _unit(values: np.ndarray, what: str, table: TextTable) -> np.ndarray:
    _close(np.abs(np.linalg.norm(values, axis=-1) - 1), what, table)
    return unit(values)


def _close(distance: np.ndarray, what: str, table: TextTable) -> None:
    bad = np.flatnonzero(distance > 0.01)
    if bad.size:
        raise ValueError(
            f"{table.path}: the output columns are not {what}: {bad.size} of "
            f"{len(distance)} rows are off, first {table.where(int(bad[0]))} by "
            f"{distance[bad[0]]:.2g}."
        )


def write_table(path: Path, columns: list[str], texts: list[list[str]], values) -> None:
    """`texts`, a list for each of the first columns, then `values` (n, m)."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for *first, rest in zip(*texts, values, strict=True):
            writer.writerow([*first, *map(shown, rest)])
