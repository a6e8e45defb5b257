"""What the entries of a table say: numbers as people write them."""

import re
from collections.abc import Iterable
from typing import NamedTuple

MISSING = frozenset(
    ["", "-", "--", "---", ".", "?", "na", "n/a", "#n/a", "#na", "<na>", "nan", "-nan"]
    + ["+nan", "nan(ind)", "-nan(ind)", "null", "none", "nil"]
)
"""How missing values are written, in lower case."""

_SIGNS = {
    **dict.fromkeys("\u2010\u2011\u2012\u2013\u2014\u2212\ufe63\uff0d", "-"),
    **dict.fromkeys("\u00a0\u2007\u2009\u202f\u3000", " "),
    **dict.fromkeys("\u200b\u200e\u200f\u2060\ufeff", None),
    **dict.fromkeys("\u00ba\u02da", "°"),
    **dict.fromkeys("\u2019\u2032\u00b4", "'"),
    **dict.fromkeys("\u201c\u201d\u2033", '"'),
}
_TIDY = str.maketrans(_SIGNS)
_NUMBER = r"(?:\d+\.?\d*|\.\d+)"
_ANGLE = re.compile(
    rf"(?P<before>[NSEW])?\s*(?P<sign>[+-])?(?P<degrees>{_NUMBER})\s*"
    rf"(?:(?:°|deg\b|degrees?\b)\s*(?:(?P<minutes>{_NUMBER})\s*'\s*"
    rf"""(?:(?P<seconds>{_NUMBER})\s*(?:"|'')\s*)?)?)?(?P<after>[NSEW])?""",
    re.IGNORECASE,
)
_PLAIN = re.compile(r"[+-]?[\d.,]*\d[\d.,]*(e[+-]?\d+)?", re.IGNORECASE)
_FORTRAN = re.compile(r"([+-]?[\d.]+)[dD]([+-]\d+)")
_GROUPED = re.compile(r"[+-]?\d{1,3}(?:[ ']\d{3})+(?:[.,]\d*)?")
_CLOCK = r"\d{1,2}(:?\d{2}(:?\d{2}([.,]\d{1,9})?)?)?\s?(Z|UTC|[+-]\d{2}(:?\d{2})?)?"
_DATE = re.compile(
    rf"\d{{4}}([-/])\d{{1,2}}(\1\d{{1,2}}([T ]{_CLOCK})?)?|\d{{8}}T{_CLOCK}"
)
_LATITUDE = re.compile(r"(?<![a-z])[ps]?lat(itude)?(?![a-z])", re.IGNORECASE)
_LONGITUDE = re.compile(r"(?<![a-z])[ps]?(lon|long|lng|longitude)(?![a-z])", re.I)
_TWO_WAYS = (
    "can be read in two ways, with a decimal or a thousands separator. Write a decimal "
    "point, and nothing between thousands"
)


class BadEntry(ValueError):
    """A column is not of numbers: its first bad entry, and how many there are."""

    def __init__(self, index: int, count: int, reason: str):
        super().__init__(reason)
        self.index, self.count, self.reason = index, count, reason


class Marks(NamedTuple):
    """How a file writes numbers."""

    separator: str = ","
    commas: bool = False
    """Some number has a comma,"""
    decimal_commas: bool = False
    """one that cannot be between thousands."""
    points: bool = False
    """Some number has a point."""


def tidy(entry: str) -> str:
    """`entry` without spaces and quotes around it, signs as ASCII has them."""
    text = entry.translate(_TIDY).strip()
    if len(text) > 1 and text[0] == text[-1] and text[0] in "'\"":
        text = text[1:-1].strip()
    return text


def is_missing(entry: str) -> bool:
    return tidy(entry).lower() in MISSING


def is_date(entry: str) -> bool:
    """Year, month, day and time in this order, as ISO 8601 has them."""
    return _DATE.fullmatch(tidy(entry)) is not None


def is_data(entry: str) -> bool:
    """A number or a date, with any decimal mark: no name of a column."""
    if is_date(entry):
        return True
    try:
        _numeral(tidy(entry).replace(",", "."), ".", "NSEW")
    except ValueError:
        return False
    return not is_missing(entry)


def marks_of(entries: Iterable[str], separator: str) -> Marks:
    """From all entries of a file."""
    commas = decimal_commas = points = False
    for entry in entries:
        if "," in entry or "." in entry:
            text = _core(entry)
            comma = _plain(text, ",")
            commas = commas or comma
            decimal_commas = decimal_commas or (comma and not _grouped(text, ","))
            points = points or _plain(text, ".")
    return Marks(separator, commas, decimal_commas, points)


def hemispheres(name: str) -> str:
    """The letters that a column of this name may have: of a latitude, of a longitude or
    none."""
    return "NS" if _LATITUDE.search(name) else "EW" if _LONGITUDE.search(name) else ""


def numerals(entries: list[str], marks: Marks, letters: str = "") -> list[str]:
    """The numbers of a column as `float` reads them, "" where missing. Degree, minute
    and second signs become degrees; `letters` are the hemispheres it may have, "NS" or
    "EW", of which S and W are negative.

    Raises `BadEntry`."""
    texts = [entry if entry.isdecimal() else tidy(entry) for entry in entries]
    texts = ["" if text.lower() in MISSING else text for text in texts]
    foreign = marks.commas and marks.separator != ","
    mark = "."
    if foreign or any("," in text for text in texts):
        mark = _decimal_mark(texts, marks)
    found, bad = [], []
    for i, text in enumerate(texts):
        try:
            found.append(_numeral(text, mark, letters) if text else "")
        except ValueError as error:
            bad.append((i, str(error)))
    if bad:
        raise BadEntry(bad[0][0], len(bad), bad[0][1])
    return found


def _numeral(text: str, mark: str, letters: str) -> str:
    plain = text.replace(",", ".") if mark == "," else text
    if _is_float(plain):
        return plain
    if _is_float(plain := _FORTRAN.sub(r"\1e\2", plain)):
        return plain
    if _GROUPED.fullmatch(plain):
        raise ValueError(_TWO_WAYS)
    angle = _ANGLE.fullmatch(plain)
    if angle is None:
        raise ValueError("")
    letter = ((angle["before"] or "") + (angle["after"] or "")).upper()
    if letter and letter not in list(letters):
        kinds = {"NS": "a latitude, N or S", "EW": "a longitude, E or W"}
        of = kinds.get(
            letters, "neither latitude nor longitude; give numbers with a sign"
        )
        raise ValueError(f"has the hemisphere '{letter}', but the column is {of}")
    if letter and angle["sign"]:
        raise ValueError("has a sign and a hemisphere; leave out one of them")
    parts = [float(angle[name] or 0) for name in ("degrees", "minutes", "seconds")]
    whole = angle["minutes"] is None or parts[0].is_integer()
    if max(parts[1:]) >= 60 or not whole:
        raise ValueError("is no angle in degrees, minutes and seconds")
    negative = letter in ("S", "W") or angle["sign"] == "-"
    if angle["minutes"] is None:
        return "-" * negative + angle["degrees"]
    degrees = parts[0] + (parts[1] + parts[2] / 60) / 60
    return repr(-degrees if negative else degrees)


def _is_float(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text  # Python's own mark between thousands


def _decimal_mark(texts: list[str], marks: Marks) -> str:
    """The decimal mark of a column, a point or a comma."""
    commas = {i: core for i, t in enumerate(texts) if _plain(core := _core(t), ",")}
    points = {i: core for i, t in enumerate(texts) if _plain(core := _core(t), ".")}
    if not commas:
        foreign = marks.commas and marks.separator != "," and points
        if foreign and all(_grouped(text, ".") for text in points.values()):
            raise BadEntry(min(points), len(points), _TWO_WAYS)
        return "."
    sure = marks.decimal_commas or (marks.separator == ";" and not marks.points)
    sure = sure or any(not _grouped(text, ",") for text in commas.values())
    several = [i for i, text in commas.items() if text.count(",") > 1]
    if not sure:
        raise BadEntry(min(commas), len(commas), _TWO_WAYS)
    if several or points:
        both = [(commas, ","), (points, ".")]
        doubt = [t for t, mark in both if all(_grouped(c, mark) for c in t.values())]
        odd = several or min(doubt or (commas, points), key=len)
        raise BadEntry(min(odd), len(odd), _TWO_WAYS)
    return ","


def _core(entry: str) -> str:
    """The number in it, without signs of angles."""
    return tidy(entry).strip("NSEWnsew°'\" ")


def _plain(text: str, mark: str) -> bool:
    """A number of digits and `mark`, perhaps with the other one, too."""
    return mark in text and _PLAIN.fullmatch(text) is not None


def _grouped(text: str, mark: str) -> bool:
    """`mark` may be between thousands."""
    group = rf"[+-]?[1-9]\d{{0,2}}(?:\{mark}\d{{3}})+(?:[.,]\d*)?"
    return re.fullmatch(group, text) is not None
