"""Landmarks as tables: positions or vertex numbers, with names or without."""

import re
from pathlib import Path

from ..datasets._entries import BadEntry, is_data, is_missing, numerals
from ..datasets._text_tables import TextTable, read_text_table
from .landmark_files import FoundLandmarks

NAMES = ("name", "label", "landmark", "landmarks", "point", "id")
NUMBERS = ("vertex", "vertices", "vertexnumber", "vertexindex", "vertexid", "index")


def read_table(path: Path) -> FoundLandmarks:
    """A CSV file: columns `x, y, z` or `vertex`, perhaps `name`; without a header the
    columns of numbers are taken, three or one, and one of text for the names."""
    table = read_text_table(path, headless=True)
    if all(name.isdecimal() for name in table.columns):
        name, columns = _by_content(table)
    else:
        name, columns = _by_header(table)
    if len(columns) not in (1, 3):
        raise ValueError(
            f"{path}: expected columns `x,y,z` of positions, or `vertex` of vertex "
            "numbers (from 0), and perhaps `name`. It has: "
            f"{', '.join(table.columns)}."
        )
    values = [_column(table, column) for column in columns]
    rows = list(zip(*values, strict=True))
    places = [None if None in row else list(row) for row in rows]
    if len(columns) == 1:
        places = [None if row is None else _whole(table, row[0]) for row in places]
    return FoundLandmarks(None if name is None else table.columns[name], places)


def _by_header(table: TextTable) -> tuple[str | None, list[str]]:
    fold = lambda text: re.sub(r"\(.*\)|\[.*\]|[^a-z]", "", text.lower())
    folded = {fold(name): name for name in reversed(table.columns)}
    name = next((folded[n] for n in NAMES if n in folded), None)
    if all(axis in folded for axis in "xyz"):
        return name, [folded[axis] for axis in "xyz"]
    return name, [folded[n] for n in NUMBERS if n in folded][:1]


def _by_content(table: TextTable) -> tuple[str | None, list[str]]:
    number = lambda entry: is_data(entry) or is_missing(entry)
    columns = [n for n, c in table.columns.items() if all(map(number, c))]
    names = [n for n in table.columns if n not in columns]
    if len(columns) in (2, 4) and not names:  # a number for each, then its place
        names, columns = columns[:1], columns[1:]
    return (names[0] if names else None), columns if len(names) < 2 else []


def _column(table: TextTable, name: str) -> list[float | None]:
    entries = table.columns[name]
    try:
        texts = numerals(entries, table.marks)
    except BadEntry as bad:
        raise ValueError(
            f"{table.path}: column `{name}` has {entries[bad.index]!r} in "
            f"{table.where(bad.index)}, no number."
        ) from None
    return [float(text) if text else None for text in texts]


def _whole(table: TextTable, value: float) -> int:
    if value != int(value):
        raise ValueError(
            f"{table.path}: vertex numbers are whole, found {value}. For positions give "
            "columns `x,y,z`."
        )
    return int(value)
