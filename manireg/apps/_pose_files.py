"""Files of poses: TUM, KITTI, and tables with names, such as EuRoC's and those of inertial
sensors."""

import csv
import re
import warnings
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from .._input.shown import shown
from ..datasets._entries import BadEntry, is_missing, numerals
from ..datasets._text_tables import TextTable, read_text_table
from ..manifolds._matrices.poses import matrices_of, quaternions_of, rotations_of
from ._stamps import Stamps

TIMES = (
    r"#?\s*(time_?stamp|stamp|time|t|sec|secs|seconds|epoch)",
    r"header_stamp|sample_?time(fine)?",
)
UNIT = r"(_?(since\w*|utc|unix|elapsed))?(_(?P<unit>ns|nsec|us|usec|ms|msec|s|sec))?"
COUNTERS = r"#?\s*(packet|frame|index|sample|counter|packet_?(number|counter))"
POSITIONS = (
    r"p_?{}", r"t_?{}", r"(\w+_)?pos(ition)?_?{}", r"p_\w+_{}", r"(\w+_)?translation_{}",
    r"{}",
)  # fmt: skip
QUATERNIONS = (
    r"q_?{}",
    r"q_\w+_{}",
    r"(\w+_)?(quat|quaternion|orientation|rotation)_?{}",
)
TUM_COLUMNS, KITTI_COLUMNS = 8, 12
NAMES_OF_UNITS = {"nsec": "ns", "usec": "us", "msec": "ms", "sec": "s"}


class PoseTable(NamedTuple):
    """Poses in the order of a file."""

    kind: Literal["tum", "kitti", "csv"]
    stamps: Stamps | None
    """None where the file has none."""
    positions: Float[np.ndarray, "k 3"] | None
    quaternions: Float[np.ndarray, "k 4"]
    """w, x, y, z, of the body in space."""
    columns: tuple[str, ...] = ()
    """Of a csv file: names of the time, the positions, and the quaternion as it is
    there, such as q0, q1, q2, q3."""
    scalar_first: bool = True
    """Whether these columns are."""
    read: str = ""
    """What was taken for what."""


def read_poses(path: str | Path, unit: str | None = None) -> PoseTable:
    """Poses of a body in space from a text file: without a header eight columns are TUM's,
    `t x y z qx qy qz qw`, twelve KITTI's, the rows of [R | t]; tables with a header are
    read by the names of their columns: a time (`timestamp`, `t_ns`, `time_s` ...),
    positions (`px`, `tx`, `x`, `p_RS_R_x` ...), which may be missing, and a quaternion
    (`qw`, `q_RS_w`, `q0` for the scalar ...). Rows with a missing value are left out, with
    a warning.

    - `unit`: of times, "s", "ms", "us" or "ns"; by default that of the column's name, or
      told by the size of numbers.

    **Raises** ValueError that names the file, the row or the column."""
    path = Path(path)
    table = _complete(read_text_table(path, headless=True))
    names = list(table.columns)
    headless = names == [str(i + 1) for i in range(len(names))]
    if headless and len(names) == KITTI_COLUMNS:
        matrices = _numbers(table, names).reshape(-1, 3, 4)
        rotations, positions = _checked(path, matrices_of, matrices)
        return PoseTable("kitti", None, positions, quaternions_of(rotations, "wxyz"))
    if headless and len(names) != TUM_COLUMNS:
        raise ValueError(
            f"{path}: {len(names)} columns without a header; TUM files have 8 "
            "(t x y z qx qy qz qw), KITTI's 12. Give other tables a line of names."
        )
    if headless:
        found = _Columns(names[0], None, False, names[1:4], names[4:], False)
    else:
        found = _find(path, names)
    stamps = None
    if found.time is not None and not found.counter:
        stamps = Stamps.of(_texts(table, found.time), unit or found.unit)
    positions = _numbers(table, found.positions) if found.positions else None
    order = "wxyz" if found.scalar_first else "xyzw"
    given = _numbers(table, found.quaternion)
    rotations = _checked(path, rotations_of, given, order)
    quaternions = quaternions_of(rotations, "wxyz")
    time = "time" if found.time is None or found.counter else found.time
    columns = [time, *found.positions, *found.quaternion]
    if not headless and _is_commented(path, names[0]):
        columns[0] = "#" + columns[0]  # as EuRoC's tools expect it
    plain = [columns[0].lstrip("#"), *columns[1:]]
    tum = headless or (path.suffix in (".tum", ".txt") and plain == names)
    tum = tum and not found.scalar_first and len(columns) == TUM_COLUMNS
    kind, read = ("tum", "") if tum else ("csv", ", ".join(columns))
    return PoseTable(
        kind, stamps, positions, quaternions, tuple(columns), found.scalar_first, read
    )


def read_stamps(path: str | Path, unit: str | None = None) -> Stamps:
    """Of the only column, or that with the name of a time."""
    table = read_text_table(Path(path), headless=True)
    names = list(table.columns)
    if len(names) == 1 or names == [str(i + 1) for i in range(len(names))]:
        return Stamps.of(_texts(table, names[0]), unit)
    name, found, counter = _time(Path(path), names)
    if name is None or counter:
        raise ValueError(f"{path}: no column has the name of a time; call it `time`.")
    return Stamps.of(_texts(table, name), unit or found)


def write_poses(
    path: str | Path,
    like: PoseTable,
    stamps: Stamps | None,
    positions: Float[np.ndarray, "q 3"] | None,
    quaternions: Float[np.ndarray, "q 4"],
) -> None:
    """In the format that `like` was read from: its columns of time and pose."""
    times = [] if stamps is None else [stamps.texts()]
    if like.kind == "kitti":
        assert positions is not None
        matrices = np.concatenate(
            [rotations_of(quaternions, "wxyz"), positions[:, :, None]], axis=2
        )
        rows, separator, times = matrices.reshape(-1, 12), " ", []
    else:
        q = quaternions if like.scalar_first else np.roll(quaternions, -1, axis=1)
        rows = q if positions is None else np.concatenate([positions, q], axis=1)
        separator = " " if like.kind == "tum" else ","
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, delimiter=separator, lineterminator="\n")
        if like.kind == "csv":
            writer.writerow(like.columns)
        for *first, row in zip(*times, rows, strict=True):
            writer.writerow([*first, *map(shown, row)])


class _Columns(NamedTuple):
    time: str | None
    unit: str | None
    counter: bool
    """Of a column that counts rows and tells no time."""
    positions: list[str]
    quaternion: list[str]
    scalar_first: bool


def _find(path: Path, names: list[str]) -> _Columns:
    time, unit, counter = _time(path, names)
    positions = _several(path, names, POSITIONS, "xyz", "positions")
    quaternion = _several(path, names, QUATERNIONS, "wxyz", "quaternion")
    quaternion = quaternion or _several(path, names, (r"q_?{}",), "0123", "quaternion")
    if not quaternion:
        raise ValueError(
            f"{path}: no quaternion among the columns {', '.join(names)}. Call them "
            "qw, qx, qy, qz (or q0, q1, q2, q3 with the scalar first)."
        )
    there = sorted(quaternion, key=names.index)
    return _Columns(time, unit, counter, positions, there, there[0] == quaternion[0])


def _time(path: Path, names: list[str]) -> tuple[str | None, str | None, bool]:
    found = []
    for name in names:
        plain, bracket = _plain(name)
        for pattern in TIMES:
            if match := re.fullmatch(f"({pattern}){UNIT}", plain):
                unit = bracket or match["unit"]
                found.append((name, NAMES_OF_UNITS.get(unit, unit), False))
                break
    if len(found) > 1:  # nanoseconds have every digit
        fine = [one for one in found if one[1] == "ns"]
        if len(fine) != 1:
            several = ", ".join(name for name, *_ in found)
            raise ValueError(f"{path}: several columns may be the time: {several}.")
        return fine[0]
    counters = [name for name in names if re.fullmatch(COUNTERS, _plain(name)[0])]
    if counters and not found:
        return counters[0], None, True
    return found[0] if found else (None, None, False)


def _several(
    path: Path, names: list[str], patterns: tuple[str, ...], letters: str, what: str
) -> list[str]:
    """The columns of all letters, by the first of the patterns that has them."""
    plain = {name: _plain(name)[0] for name in names}
    for pattern in patterns:
        each = [
            [n for n, p in plain.items() if re.fullmatch(pattern.format(c), p)]
            for c in letters
        ]
        if all(each) and max(map(len, each)) > 1:
            twice = next(found for found in each if len(found) > 1)
            raise ValueError(
                f"{path}: several columns may be the {what}: {', '.join(twice)}. Rename "
                "those that are not."
            )
        if all(each):
            return [found[0] for found in each]
    return []


def _is_commented(path: Path, first: str) -> bool:
    """Whether the header is the comment that the file starts with."""
    with path.expanduser().open("rb") as file:
        line = file.readline().decode("utf-8", "replace").lstrip("\ufeff")
    return line.startswith("#") and line[1:].strip().startswith(first)


def _plain(name: str) -> tuple[str, str | None]:
    """Lower case, without the unit in brackets; and that."""
    bracket = re.search(r"[\[(](\w+)[\])]", name)
    text = re.sub(r"\s*[\[(].*[\])]", "", name).strip().lower()
    unit = bracket[1].lower() if bracket else None
    return re.sub(r"[.\s/]+", "_", text), unit


def _complete(table: TextTable) -> TextTable:
    width = range(len(table.rows))
    columns = table.columns.values()
    bad = [i for i in width if any(is_missing(column[i]) for column in columns)]
    if not bad:
        return table
    warnings.warn(
        f"{table.path}: {len(bad)} of {len(table.rows)} rows have missing values and are "
        f"left out, first {table.where(bad[0])}.",
        stacklevel=3,
    )
    kept = sorted(set(width) - set(bad))
    if not kept:
        raise ValueError(f"{table.path}: no row has values in all columns.")
    return table.take(kept)


def _texts(table: TextTable, name: str) -> list[str]:
    try:
        return numerals(table.columns[name], table.marks)
    except BadEntry as bad:
        entry = table.columns[name][bad.index]
        raise ValueError(
            f"{table.path}: column `{name}` has '{entry}', which is no number, in "
            f"{table.where(bad.index)}."
        ) from None


def _numbers(table: TextTable, names: list[str]) -> Float[np.ndarray, "k n"]:
    return np.array([_texts(table, name) for name in names], object).astype(float).T


def _checked(path: Path, function, *arguments: Any) -> Any:
    try:
        return function(*arguments)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
