"""A table as it is in a file: columns of text, and the line of each row."""

import csv
import io
import re
import warnings
from pathlib import Path
from typing import NamedTuple

from ._encodings import decoded
from ._entries import Marks, is_data, is_missing, marks_of, tidy

SEPARATORS = (",", ";", "\t", "|", " ")
# Excel writes `#N/A` and the like where a formula has no value: no comments
_COMMENT = re.compile(r"\s*(#(?!N/A|NA\b|DIV/0!|VALUE!|REF!|NUM!|NAME\?|NULL!)|%|//)")
_EXCEL_HINT = re.compile(r'"?sep=(.)"?')
_UNIT = re.compile(
    r"[\[(].*[\])]|°|%|(deg|rad|degree|radian)s?(/\w+)?|[num]?s|secs?|seconds?|mins?|"
    r"minutes?|hrs?|hours?|h|days?|d|years?|yrs?|[kmg]?[ay]r?|[nmck]?m([/ ]\w+.*)?|"
    r"n?T|g|h?pa|k|°c|knots|kts?|unitless",
    re.IGNORECASE,
)


class TextTable(NamedTuple):
    """Columns of text, all of one length."""

    path: Path
    columns: dict[str, list[str]]
    rows: list[int]
    """Number of each row among the data, from 1."""
    lines: list[int]
    """Line of the file where each row starts, from 1."""
    marks: Marks

    def where(self, index: int) -> str:
        return f"data row {self.rows[index]} (line {self.lines[index]})"

    def take(self, indices: list[int]) -> "TextTable":
        """The rows at `indices`."""
        take = lambda entries: [entries[i] for i in indices]
        columns = {name: take(entries) for name, entries in self.columns.items()}
        rows, lines = take(self.rows), take(self.lines)
        return self._replace(columns=columns, rows=rows, lines=lines)


def read_text_table(path: Path, headless: bool = False) -> TextTable:
    """The table in a text file: separated by `,`, `;`, tabs, `|` or spaces; UTF-8,
    UTF-16 or Windows-1252. Lines that are empty or start with `#`, `%` or `//` do not
    count; the first other one is the header. Where that looks like the data below it and
    the comment above it does not, the comment is the header (`# age,lat,lon`). A line of
    units below the header is left out with a warning. `headless`: if the first line looks
    like data, it is; columns are then called "1", "2", ...

    Raises `FileNotFoundError`, or a `ValueError` that names the file and the line."""
    path = path.expanduser()
    text = decoded(path).replace("\r\n", "\n").replace("\r", "\n").rstrip("\x1a")
    lines = text.split("\n")
    comments = {i: line for i, line in enumerate(lines, 1) if _COMMENT.match(line)}
    lines = ["" if i in comments else line for i, line in enumerate(lines, 1)]
    filled = [line for line in lines if line.strip()]
    if filled and (hint := _EXCEL_HINT.fullmatch(filled[0].strip(" "))):
        lines[lines.index(filled[0])] = ""
        separator = hint[1]
    else:
        separator = _separator(filled[:100])
    records = _records(path, lines, separator)
    header = _commented_header(records, comments, separator)
    if header is None and headless and records and _alike(records):
        header = [str(i + 1) for i in range(max(len(r) for _, r in records))]
    if header is None and records:
        header = records.pop(0)[1]
    if header is None or not records:
        raise ValueError(f"{path}: needs a header line and at least one row.")
    names = [tidy(name) for name in header]
    if _row_names(names, records, separator):
        names = ["", *names]
    _check_lengths(path, names, records, separator)
    _check_names(path, names)
    _leave_out_units(path, records)
    columns = {
        name: [record[i].strip() if i < len(record) else "" for _, record in records]
        for i, name in enumerate(names)
        if name
    }
    marks = Marks(separator)
    if separator != "," or '"' in text:
        entries = (entry for column in columns.values() for entry in column)
        marks = marks_of(entries, separator) if "," in text else marks
    rows = list(range(1, len(records) + 1))
    return TextTable(path, columns, rows, [line for line, _ in records], marks)


def _fields(line: str, separator: str) -> list[str]:
    if separator == " ":
        line = " ".join(line.split())
    return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])


def _separator(lines: list[str]) -> str:
    """What splits most lines into as many fields as the first; half as good is one field
    more, the name of a row."""
    best, most = ",", 0.0
    for separator in SEPARATORS:
        counts = [len(_fields(line, separator)) for line in lines]
        if not counts or counts[0] < 2:
            continue
        trimmed = len(_trimmed(_fields(lines[0], separator)))
        fit = [trimmed <= count <= counts[0] + 1 for count in counts[1:]]
        exact = [trimmed <= count <= counts[0] for count in counts[1:]]
        share = (sum(fit) + sum(exact)) / (2 * max(len(fit), 1))
        # a header of two words is not yet a table of two columns
        share = share or 1e-9 * (separator != " ")
        if share > most:
            best, most = separator, share
    return best


def _trimmed(fields: list[str]) -> list[str]:
    """Without empty fields at the end."""
    last = max((i for i, field in enumerate(fields) if field.strip()), default=-1)
    return fields[: last + 1]


def _records(path: Path, lines: list[str], separator: str):
    """The lines that are not empty, as pairs of the number in the file and the
    fields."""
    import pandas  # slow to import

    if separator == " ":
        lines = [" ".join(line.split()) for line in lines]
    width = 1 + max((line.count(separator) for line in lines), default=0)
    if not any(lines):
        return []
    try:
        # only the Python engine tells a row that ends early from empty fields
        frame = pandas.read_csv(
            io.StringIO("\n".join(lines)),
            sep=separator,
            header=None,
            names=list(range(width)),
            dtype=str,
            keep_default_na=False,
            skip_blank_lines=False,
            skipinitialspace=True,
            engine="python",
        )
    except pandas.errors.ParserError as error:
        raise ValueError(
            f"{path}: {error}. Is a quote opened and not closed?"
        ) from None
    there = frame.notna().to_numpy()
    lengths = there.sum(axis=1)
    fields = frame.to_numpy(dtype=object)
    records, line = [], 1
    for row, length in zip(fields, lengths, strict=True):
        record = row[:length].tolist()
        if any(field.strip() for field in record):
            records.append((line, record))
        line += 1 + sum(field.count("\n") for field in record)
    return records


def _commented_header(records, comments: dict[int, str], separator: str):
    """The names in the comment above the first row, if that is no header itself."""
    above = [line for line in comments if records and line < records[0][0]]
    if not above:
        return None
    names = _fields(comments[max(above)].lstrip("#%/ \t"), separator)
    first = [is_data(field) for field in records[0][1]]
    second = [is_data(field) for field in records[min(1, len(records) - 1)][1]]
    alike = any(first) and first == second
    if alike and len(names) == len(first) and not any(map(is_data, names)):
        return names
    return None


def _alike(records) -> bool:
    """Whether the first record has numbers where the second has."""
    first, second = (list(map(is_data, r)) for _, r in (records[0], records[:2][-1]))
    return any(first) and first == second


def _row_names(names: list[str], records, separator: str) -> bool:
    """R writes the names of rows first, without a name in the header."""
    if not all(names) or any(len(record) != len(names) + 1 for _, record in records):
        return False
    firsts = [record[0] for _, record in records]
    if not any(map(is_data, firsts)):
        return len(set(firsts)) == len(firsts)
    return separator != "," and firsts == [str(i + 1) for i in range(len(firsts))]


def _check_lengths(path: Path, names: list[str], records, separator: str) -> None:
    least = len(_trimmed(names))
    for line, record in records:
        if least <= len(record) and len(_trimmed(record)) <= len(names):
            continue
        cure = "Is the line cut off?" if len(record) < least else ""
        if len(record) > least and separator == ",":
            cure = "Quote entries with commas, or separate columns by `;`."
        if least == 1:
            cure += " Put # before lines above the header."
        raise ValueError(
            f"{path}, line {line}: {len(record)} fields, but the header has "
            f"{least} column{'s' if least > 1 else ''}. {cure.strip()}"
        )


def _check_names(path: Path, names: list[str]) -> None:
    for name in filter(None, names):
        if names.count(name) > 1:
            raise ValueError(
                f"{path}: the header has the column `{name}` twice. Rename one."
            )


def _leave_out_units(path: Path, records) -> None:
    """The first record, if it has units where all others have numbers."""
    line, first = records[0]
    if len(records) < 2 or any(map(is_data, first)):
        return
    width = min(len(record) for _, record in records)
    numbers = [
        i
        for i in range(width)
        if all(is_data(r[i]) or is_missing(r[i]) for _, r in records[1:])
        and any(is_data(r[i]) for _, r in records[1:])
    ]
    units = [tidy(first[i]) for i in numbers]
    if not any(map(_UNIT.fullmatch, units)):
        return
    warnings.warn(
        f"{path}: line {line} has units ({', '.join(units)}) and is left out.",
        stacklevel=4,
    )
    del records[0]
