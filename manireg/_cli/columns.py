"""Columns of a table, as options of the command line name them."""

import csv
import difflib
import warnings
from collections.abc import Sequence
from enum import StrEnum
from itertools import groupby

import numpy as np

from ..datasets._entries import (
    BadEntry,
    hemispheres,
    is_data,
    is_date,
    is_missing,
    numerals,
    tidy,
)
from ..datasets._text_tables import TextTable

MOST_SHOWN = 20  # runs of rows in a message


class Missing(StrEnum):
    drop = "drop"
    error = "error"


def split_names(columns: str | None) -> list[str]:
    """Names between commas; one that has a comma is quoted."""
    names = next(csv.reader([columns or ""], skipinitialspace=True), [""])
    return [name.strip() for name in names]


def find(table: TextTable, name: str, option: str) -> str:
    """The name in the table: the same, or the same but for case, spaces and quotes."""
    if name in table.columns:
        return name
    alike = [other for other in table.columns if _folded(other) == _folded(name)]
    if len(alike) == 1:
        return alike[0]
    there = ", ".join(table.columns)
    if alike:
        raise ValueError(
            f"{table.path} has several columns that `{name}` for {option} may be: "
            f"{', '.join(alike)}. Write one as it is there."
        )
    folded = {_folded(other): other for other in table.columns}
    close = difflib.get_close_matches(_folded(name), folded, n=1)
    cure = f" Did you mean `{folded[close[0]]}`?" if close else ""
    if all(map(is_data, table.columns)):
        cure = " That looks like data: give the table a header line."
    raise ValueError(
        f"{table.path} has no column `{name}` for {option}. It has: {there}.{cure}"
    )


def has(table: TextTable, *names: str) -> bool:
    return {_folded(n) for n in names} <= {_folded(n) for n in table.columns}


def complete(table: TextTable, names: list[str], missing: Missing) -> TextTable:
    """The rows that have an entry in all columns `names`; a warning tells the others."""
    gaps = [
        (i, name)
        for i in range(len(table.rows))
        for name in names
        if is_missing(table.columns[name][i])
    ]
    if not gaps:
        return table
    index, name = gaps[0]
    entry = table.columns[name][index]
    what = f"column `{name}` is {_quoted(entry)} in {table.where(index)}"
    if missing == Missing.error:
        raise ValueError(
            f"{_gaps(table, name, [i for i, n in gaps if n == name])} Fill in the values "
            "or leave out rows without them: --missing drop."
        )
    left_out = sorted({i for i, _ in gaps})
    kept = sorted(set(range(len(table.rows))) - set(left_out))
    if not kept:
        raise ValueError(
            f"{table.path}: no row has values in all of {', '.join(names)}; first, {what}."
        )
    rows = [table.rows[i] for i in left_out]
    lines = [table.lines[i] for i in left_out]
    warnings.warn(
        f"{table.path}: {len(left_out)} of {len(table.rows)} rows have missing values and "
        f"are left out: data row{'s' * (len(rows) > 1)} {runs(rows)} (line"
        f"{'s' * (len(lines) > 1)} {runs(lines)}); first, {what}.",
        stacklevel=2,
    )
    return table.take(kept)


def column(
    table: TextTable, name: str, option: str, letters: str | None = None
) -> list[str]:
    """The numbers of a column as `float` reads them, all there and finite. `letters`:
    see `numerals`; by default the name of the column tells."""
    texts = _texts(table, name, option, letters)
    gaps = [i for i, t in enumerate(texts) if not t or not np.isfinite(float(t))]
    if gaps:
        raise ValueError(f"{_gaps(table, name, gaps)} Remove these rows.")
    return texts


def numbers(
    table: TextTable,
    names: Sequence[str],
    option: str,
    letters: Sequence[str | None] | None = None,
) -> np.ndarray:
    """The columns `names` (k, len(names)), checked to be finite numbers."""
    letters = [None] * len(names) if letters is None else letters
    texts = [
        column(table, find(table, name, option), option, of)
        for name, of in zip(names, letters, strict=True)
    ]
    return np.array(texts, dtype=object).astype(float).T


def numbers_or_nan(table: TextTable, name: str, option: str) -> np.ndarray:
    """A column (k,) with NaN where there is no entry. Infinity counts as none."""
    texts = _texts(table, name, option, None)
    values = np.array([float(text) if text else np.nan for text in texts])
    return np.where(np.isfinite(values), values, np.nan)


def _texts(table: TextTable, name: str, option: str, letters: str | None) -> list[str]:
    letters = hemispheres(name) if letters is None else letters
    try:
        return numerals(table.columns[name], table.marks, letters)
    except BadEntry as bad:
        raise ValueError(_bad_entry(table, name, option, bad)) from None


def refuse(
    table: TextTable, name: str, bad: np.ndarray, demand: str, cure: str
) -> None:
    """Raises ValueError that names the first row where `bad`."""
    if not bad.any():
        return
    i = int(np.argmax(bad))
    raise ValueError(
        f"{table.path}: {demand}, but column `{name}` has {tidy(table.columns[name][i])} "
        f"in data row {table.rows[i]}. {cure} (line {table.lines[i]})."
    )


def _bad_entry(table: TextTable, name: str, option: str, bad: BadEntry) -> str:
    entry = tidy(table.columns[name][bad.index])
    first = f"first in {table.where(bad.index)}" if bad.count > 1 else ""
    where = f"in {bad.count} rows, {first}" if first else table.where(bad.index)
    if bad.reason:
        return f"{table.path}: column `{name}`: '{entry}' {bad.reason} ({where})."
    needs = "numbers"
    if option == "--input":
        needs = "numbers, or dates as 2024-05-01"
    elif is_date(entry):
        needs = "numbers; dates are for --input"
    return (
        f"{table.path}: column `{name}` has text, '{entry}'; {option} needs {needs} "
        f"({where})."
    )


def _gaps(table: TextTable, name: str, gaps: list[int]) -> str:
    entry = table.columns[name][gaps[0]]
    return (
        f"{table.path}: column `{name}` is empty or not finite in {len(gaps)} of "
        f"{len(table.rows)} rows, first {_quoted(entry)} in {table.where(gaps[0])}."
    )


def _quoted(entry: str) -> str:
    return f"'{tidy(entry)}'" if tidy(entry) else "empty"


def _folded(name: str) -> str:
    return " ".join(tidy(name).casefold().split())


def runs(numbers: list[int]) -> str:
    """`3, 7 to 9`."""
    grouped = groupby(enumerate(numbers), lambda pair: pair[1] - pair[0])
    found = [[number for _, number in run] for _, run in grouped]
    texts = [f"{r[0]} to {r[-1]}" if len(r) > 1 else str(r[0]) for r in found]
    more = sum(map(len, found[MOST_SHOWN:]))
    return ", ".join(texts[:MOST_SHOWN]) + (f" and {more} more" if more else "")
