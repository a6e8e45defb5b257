"""What users have, as float64 arrays: one conversion for every input, and what it does
not take.

Taken are numbers of every kind (integers, float32, `Decimal`, `Fraction`) in arrays,
series, frames, (nested) lists and arrays of objects, lists of arrays of one shape, and
rotations of scipy. What is missing (`None`, pandas' `NA`, `NaT`) becomes NaN, which the
checks then name. Not taken, because a number would be made up: masked entries, texts,
truth values, complex numbers, records.
"""

import datetime
from typing import Any

import numpy as np

Numbers = Any
"""What `as_numbers` takes."""

SINCE_EPOCH = "seconds since 1970-01-01 UTC"
SECONDS = "seconds"
_TIMES = {"M": SINCE_EPOCH, "m": SECONDS}  # by the kind of a dtype
_TEMPORAL = (datetime.date, datetime.timedelta, np.datetime64, np.timedelta64)
_NO_NUMBER = (str, bytes, bool, np.bool_, complex, np.complexfloating)


def as_numbers(name: str, values: Numbers) -> np.ndarray:
    """`values` as a float64 array; dates and durations are refused."""
    array, unit = numbers_and_unit(name, values)
    if unit:
        raise ValueError(
            f"{name}: expected real numbers, found dates or durations. They are taken as "
            "points of an Interval, a Box or a Euclidean space; make numbers of these, in "
            "a unit of your choice."
        )
    return array


def numbers_and_unit(name: str, values: Numbers) -> tuple[np.ndarray, str]:
    """`values` as a float64 array, dates in seconds since 1970-01-01 UTC (those without a
    time zone count as UTC), durations in seconds; and that unit, empty for plain numbers.
    A float64 tells today's dates apart to 2e-7 s."""
    refuse_masked(name, values)
    if hasattr(values, "as_matrix"):  # rotations
        values = values.as_matrix()
    try:
        array = np.asarray(values)
    except ValueError:  # entries of several shapes
        array = np.full(len(values), None, dtype=object)
        for i, value in enumerate(values):
            array[i] = value
    kind = array.dtype.kind
    if kind in "fiu":
        return array.astype(float, copy=False), ""
    if kind in _TIMES:
        return _seconds(name, array), _TIMES[kind]
    if kind == "O":
        return _from_objects(name, array)
    if array.dtype.names:
        raise ValueError(
            f"{name}: expected real numbers, found records with the fields "
            f"{', '.join(array.dtype.names)}; take one of them, or stack their columns."
        )
    raise ValueError(
        f"{name}: expected real numbers, found dtype {array.dtype}"
        f"{_first_odd(values, array)}."
    )


def refuse_masked(name: str, values: Numbers) -> None:
    """NumPy forgets the mask when it makes an array of a masked one."""
    if not _has_masked(values):
        return
    if getattr(values, "ndim", 1) == 0:
        raise ValueError(f"{name}: is masked; give a number.")
    rows = [i for i, row in enumerate(values) if _has_masked(row)]
    raise ValueError(
        f"{name}: {len(rows)} of {len(values)} points hold masked entries (first at index "
        f"{rows[0]}). Leave these pairs out, or fill them in."
    )


def _has_masked(values) -> bool:
    if isinstance(values, np.ma.MaskedArray):
        return not values.dtype.names and bool(np.any(np.ma.getmaskarray(values)))
    return isinstance(values, list | tuple) and any(map(_has_masked, values))


def _seconds(name: str, array: np.ndarray) -> np.ndarray:
    unit = np.datetime_data(array.dtype)[0]
    if array.dtype.kind == "m" and unit in ("Y", "M", "generic"):
        raise ValueError(
            f"{name}: durations in the unit '{unit}' have no length in seconds; convert "
            "them, e.g. to days."
        )
    if unit == "generic":  # nothing but NaT
        return np.full(array.shape, np.nan)
    whole = array.astype(f"{array.dtype.kind}8[s]")
    seconds = whole.astype(np.int64) + (array - whole) / np.timedelta64(1, "s")
    return np.where(np.isnat(array), np.nan, seconds)


def _from_objects(name: str, array: np.ndarray) -> tuple[np.ndarray, str]:
    """Number by number. Entries may be arrays: all of one shape, or missing."""
    rows = np.indices(array.shape)[0].ravel().tolist() if array.ndim else [None]
    entries, units, shape, first = [], set(), (), None
    for row, value in zip(rows, array.ravel()):
        if _is_missing(value):
            entries.append(None)
            continue
        entry, unit = _entry(name, row, value)
        if first is not None and entry.shape != shape:
            raise ValueError(
                f"{name}: entries of several shapes, {shape} at index {first} and "
                f"{entry.shape} at index {row}."
            )
        first, shape = (row, entry.shape) if first is None else (first, shape)
        entries.append(entry)
        units.add(unit)
        if len(units) > 1:
            raise ValueError(
                f"{name}: dates, durations and numbers are mixed (first at index {row}); "
                "give all of them as numbers."
            )
    filled = [np.full(shape, np.nan) if e is None else e for e in entries]
    return np.reshape(filled, (*array.shape, *shape)), "".join(units)


def _entry(name: str, row: int | None, value) -> tuple[np.ndarray, str]:
    where = name if row is None else f"{name}[{row}]"
    if isinstance(value, _TEMPORAL):
        return _time(where, value)
    if not isinstance(value, _NO_NUMBER):
        if isinstance(value, list | tuple | np.ndarray) or hasattr(value, "as_matrix"):
            return numbers_and_unit(where, value)
        if getattr(value, "ndim", 0):  # arrays of others, such as JAX
            return numbers_and_unit(where, np.asarray(value))
        try:
            return np.asarray(float(value)), ""
        except OverflowError:
            return np.asarray(np.inf), ""
        except (TypeError, ValueError, ArithmeticError):
            pass
    text = repr(value) if isinstance(value, _NO_NUMBER) else f"a {type(value).__name__}"
    index = "" if row is None else f" at index {row}"
    raise ValueError(f"{name}: expected real numbers, found {text}{index}.")


def _time(where: str, value) -> tuple[np.ndarray, str]:
    if isinstance(value, np.datetime64 | np.timedelta64):
        return numbers_and_unit(where, np.asarray(value))
    if isinstance(value, datetime.timedelta):
        return np.asarray(value.total_seconds()), SECONDS
    if not isinstance(value, datetime.datetime):
        value = datetime.datetime(value.year, value.month, value.day)
    if value.tzinfo is None:
        value = value.replace(tzinfo=datetime.UTC)
    return np.asarray(value.timestamp()), SINCE_EPOCH


def _is_missing(value) -> bool:
    """None, or not equal to itself: NaN, NaT, and NA, which does not know."""
    if value is None:
        return True
    if getattr(value, "shape", ()) != () or isinstance(value, list | tuple):
        return False
    try:
        return bool(value != value)
    except TypeError:
        return not hasattr(value, "__float__")
    except Exception:
        return False


def _first_odd(values, array: np.ndarray) -> str:
    """Where a text stands between numbers, NumPy makes texts of all of them."""
    if array.ndim == 0:
        return f", {array[()]!r}"
    odd = 0
    if isinstance(values, list | tuple):
        plain = lambda v: np.asarray(v).dtype.kind in "fiu"
        odd = next((i for i, v in enumerate(values) if not plain(v)), 0)
    return f" (first at index {odd})" if len(array) else ""
