"""The inputs of `manireg fit`: columns of numbers or dates, read and written exactly."""

import re
import warnings
from collections.abc import Sequence
from decimal import Decimal, localcontext
from typing import NamedTuple

import numpy as np

from .._input.shown import shown
from ..datasets._entries import is_date, tidy
from ..datasets._text_tables import TextTable
from .columns import column, find

FAR = 1e-6  # of the range: with coarser floats the origin moves to the first value
_ZONE = re.compile(r"[T ]\d\d.*(Z|UTC|[+-]\d\d(:?\d\d)?)$")
_COMPACT = re.compile(r"(19|20)\d\d(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])(\d{4}|\d{6})?")


class Axis(NamedTuple):
    """An input column as floats: how far each entry lies from `origin`, in the unit of
    the column, or in seconds where it has dates.

    The origin is zero where floats hold the entries well. Dates, and numbers such as
    nanoseconds since 1970, are subtracted and added in decimal arithmetic."""

    name: str
    origin: Decimal = Decimal(0)
    dates: bool = False
    zoned: bool = False

    @property
    def start(self) -> str:
        """The origin as the column has it."""
        return self.texts(np.zeros(1))[0]

    @property
    def label(self) -> str:
        """For the axis of a picture."""
        if self.dates:
            return f"{self.name} (s since {self.start})"
        return f"{self.name} - {self.start}" if self.origin else self.name

    def given(self, table: TextTable) -> list[str]:
        """The entries of a table as its own texts: with a decimal point, the rest as it
        is there."""
        name = find(table, self.name, "--input")
        if self.dates:
            return [tidy(entry) for entry in table.columns[name]]
        return column(table, name, "--input")

    def floats(self, table: TextTable) -> np.ndarray:
        if not self.dates and not self.origin:
            return np.array([float(text) for text in self.given(table)])
        with localcontext(prec=50):
            exact = _exact(table, find(table, self.name, "--input"), self.dates)
            return np.array([float(value - self.origin) for value in exact])

    def texts(self, floats: np.ndarray) -> list[str]:
        if not self.dates and not self.origin:
            return [shown(value) for value in floats]
        with localcontext(prec=50):
            # the last digit of the largest is noise
            far = np.abs(floats).max(initial=1e-300)
            step = Decimal(1).scaleb(int(np.floor(np.log10(far))) - 14)
            offsets = [Decimal(repr(float(v))).quantize(step) for v in floats]
            exact = [self.origin + offset for offset in offsets]
            if not self.dates:
                return [f"{value.normalize():f}" for value in exact]
            nanoseconds = [round(value * 10**9) for value in exact]
        unit = "ns" if max(map(abs, nanoseconds)) < 2**63 else "us"
        ticks = [n if unit == "ns" else round(n / 1000) for n in nanoseconds]
        dates = np.array(ticks, dtype=np.int64).view(f"M8[{unit}]")
        units = ("s", "ms", "us", "ns") if self.zoned else ("D", "s", "ms", "us", "ns")
        exact = (u for u in units if np.all(dates.astype(f"M8[{u}]") == dates))
        times = np.datetime_as_string(dates.astype(f"M8[{next(exact)}]")).tolist()
        return [f"{time}Z" if self.zoned else time for time in times]


def axis_of(name: str, tables: Sequence[TextTable]) -> Axis:
    """Of the column `name` in all `tables`, whose rows are complete."""
    places = [(table, find(table, name, "--input")) for table in tables]
    entries = [entry for table, there in places for entry in table.columns[there]]
    name = places[0][1]
    if sum(map(is_date, entries)) > len(entries) / 2:
        zoned = _ZONE.search(tidy(entries[0])) is not None
        for table, there in places:
            _check_dates(table, there, zoned)
        return Axis(name, min(_exact(tables[0], name, True)), True, zoned)
    if all(_COMPACT.fullmatch(tidy(entry)) for entry in entries):
        warnings.warn(
            f"{tables[0].path}: column `{name}` is read as numbers. If {entries[0]} is a "
            "date, write it as 2024-05-01.",
            stacklevel=2,
        )
    floats = Axis(name).floats
    values = np.concatenate([floats(table) for table in tables])
    if np.spacing(np.abs(values).max()) <= FAR * np.ptp(values):
        return Axis(name)
    return Axis(name, min(_exact(tables[0], name, False)))


def lambda_unit(axes: Sequence[Axis], order: int = 2) -> str:
    """Of a fit over `axes`, length^(2 order - m), where all are dates."""
    power = 2 * order - len(axes)
    if power < 1 or not all(axis.dates for axis in axes):
        return ""
    return "s" if power == 1 else f"s^{power}"


def _exact(table: TextTable, name: str, dates: bool) -> list[Decimal]:
    """Numbers, or dates as seconds since 1970."""
    if not dates:
        return [Decimal(text) for text in column(table, name, "--input")]
    times = _times(table.columns[name])
    ticks = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[times.unit]
    return [Decimal(tick) / ticks for tick in times.asi8.tolist()]


def _times(entries: list[str]):
    import pandas  # slow to import

    texts = [tidy(entry).replace(",", ".").replace("/", "-") for entry in entries]
    texts = [text.replace("UTC", "Z") for text in texts]
    return pandas.to_datetime(texts, format="ISO8601", utc=True, errors="coerce")


def _check_dates(table: TextTable, name: str, zoned: bool) -> None:
    entries = table.columns[name]
    for i, (entry, wrong) in enumerate(
        zip(entries, _times(entries).isna(), strict=True)
    ):
        if wrong or not is_date(entry):
            reason = "is no date as 2024-05-01 or 2024-05-01T12:30:00Z, as others are"
        elif zoned != (_ZONE.search(tidy(entry)) is not None):
            reason = "has no time zone" if zoned else "has a time zone"
            reason += (
                f", the first '{tidy(entries[0])}' has {'one' if zoned else 'none'}"
            )
        else:
            continue
        raise ValueError(
            f"{table.path}: column `{name}`: '{tidy(entry)}' {reason} "
            f"({table.where(i)})."
        )
