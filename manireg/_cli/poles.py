"""Tables of palaeomagnetic poles, by the names that their columns usually have."""

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

import manireg as mr

from ..datasets._entries import tidy
from ..datasets._text_tables import TextTable
from .columns import (
    Missing,
    complete,
    find,
    numbers,
    numbers_or_nan,
    refuse,
    split_names,
)
from .tables import TargetName, read_target

# Without case, spaces, underscores and units. Of several that are there the user has to
# say which is meant, but of `n` and `name`, where the first is taken.
NAMES = {
    "age": "age meanage agemean nominalage midage agemid",
    "age_min": "minage agemin lowage agelow lowerage agelower lomagage youngage ageyoung "
    "youngest minimumage ageminimum agemi",
    "age_max": "maxage agemax highage agehigh upperage ageupper himagage oldage ageold "
    "oldest maximumage agemaximum",
    "age_sigma": "agesigma sigmaage agesd sdage agestd stdage ageerror ageerr age1sigma "
    "1sigmaage sigma1age",
    "age_2sigma": "age2sigma 2sigmaage sigma2age age2sd",
    "distribution": "distribution agedistribution agedist",
    "lat": "lat latitude plat polelat polelatitude platitude latp vgplat",
    "lon": "lon long longitude lng plon plong polelon polelong polelongitude plongitude "
    "lonp vgplon",
    "a95": "a95 alpha95 α95 polea95",
    "k": "k kappa polek",
    "n": "n b nsites sites polen",
    "dp": "dp",
    "dm": "dm",
    "name": "name polename id poleid rockunit formation plate plateid plate_name",
}
_UNITS = re.compile(r"[\[(].*?[\])]|°")
_SUFFIX = re.compile(r"(deg|degrees|(?<!sig)ma)$")


class PoleTable(NamedTuple):
    """Rows of a table, as poles."""

    poles: mr.apps.Poles
    table: TextTable
    columns: dict[str, str]
    """By what they are, such as `age_min`."""
    precision: str
    """Where it comes from."""

    def named(self, rows: np.ndarray) -> str:
        """The rows, up to ten of them, with their names where they have some."""
        shown = [str(self.table.rows[i]) for i in rows[:10]]
        if "name" in self.columns:
            names = self.table.columns[self.columns["name"]]
            names = [tidy(names[i]) for i in rows[:10]]
            shown = [f"{row} ({name})" for row, name in zip(shown, names, strict=True)]
        more = f" and {len(rows) - 10} more" if len(rows) > 10 else ""
        return f"data row{'s' * (len(rows) > 1)} {', '.join(shown)}{more}"


def read_poles(
    table: TextTable,
    lat_lon: str | None,
    given: Sequence[str],
    where: Sequence[str],
    missing: Missing,
) -> PoleTable:
    """`given`: columns as `age=T`, for those of other names; `where`: only rows as
    `plate=europe`. **Raises** ValueError that names the column, the row and the cure."""
    for condition in where:
        table = _only(table, condition)
    columns = _found(table, lat_lon, given)
    there = {"age", "age_min", "age_max"} & columns.keys()
    if not ({"age"} <= there or {"age_min", "age_max"} <= there):
        raise ValueError(
            f"{table.path} has no column of ages, such as `age`, or `min_age` and "
            f"`max_age`. It has: {', '.join(table.columns)}. Name it: --column age=NAME."
        )
    if ("age_min" in there) != ("age_max" in there):
        one = columns[next(iter(there - {"age"}))]
        raise ValueError(
            f"{table.path}: column `{one}` is one end of a range of ages; name the other: "
            "--column age_max=NAME, or age_min=NAME."
        )
    needed = [columns["lat"], columns["lon"]]
    needed += [] if "age_min" in there else [columns["age"]]
    table = complete(table, needed, missing)
    read_target(TargetName.sphere, table, needed[:2], True)  # latitudes
    lat, lon = numbers(table, needed[:2], "--lat-lon", ("NS", "EW")).T
    a95, precision = _precision(table, columns)
    age, low, high, sigma = _ages(table, columns)
    poles = mr.apps.Poles(age, lat, lon, a95, low, high, sigma)
    return PoleTable(poles, table, columns, precision)


def _found(
    table: TextTable, lat_lon: str | None, given: Sequence[str]
) -> dict[str, str]:
    columns = {}
    for pair in given:
        role, equals, name = pair.partition("=")
        role = role.strip().lower()
        if not equals or role not in NAMES:
            raise ValueError(
                f"--column {pair}: expected NAME=COLUMN with one of {', '.join(NAMES)}, "
                "such as age=T."
            )
        columns[role] = find(table, name.strip(), "--column")
    if lat_lon is not None:
        pair = split_names(lat_lon)
        if len(pair) != 2:
            raise ValueError(f"--lat-lon takes two columns, found {len(pair)}.")
        names = (find(table, name, "--lat-lon") for name in pair)
        columns |= dict(zip(("lat", "lon"), names, strict=True))
    folded = {name: _folded(name) for name in table.columns}
    for role, names in NAMES.items():
        known = names.split()
        alike = [name for name, short in folded.items() if short in known]
        alike.sort(key=lambda name: known.index(folded[name]))
        if role in columns or not alike:
            continue
        if len(alike) > 1 and role in ("lat", "lon"):
            raise ValueError(_two_pairs(table, folded))
        if len(alike) > 1 and role not in ("n", "name"):
            raise ValueError(
                f"{table.path} has several columns that may be {role}: "
                f"{', '.join(alike)}. Say which: --column {role}={alike[0]}."
            )
        columns[role] = alike[0]
    if not {"lat", "lon"} <= columns.keys():
        raise ValueError(
            f"{table.path} has no columns of poles, such as `lat` and `lon`, or `plat` "
            f"and `plon`. It has: {', '.join(table.columns)}. Name them: --lat-lon "
            "LAT,LON."
        )
    return columns


def _two_pairs(table: TextTable, folded: dict[str, str]) -> str:
    lats, lons = (
        [name for name, short in folded.items() if short in NAMES[role].split()]
        for role in ("lat", "lon")
    )
    # of a table with both, `plat` is followed by `plon`
    pairs = [f"--lat-lon {a},{b}" for a, b in zip(lats, lons, strict=False)]
    return (
        f"{table.path} has several columns that may be the pole: {', '.join(lats)} and "
        f"{', '.join(lons)} (in other coordinates, or of the site). Say which: "
        f"{' or '.join(pairs)}."
    )


def _folded(name: str) -> str:
    short = re.sub(r"[\W_]", "", _UNITS.sub("", tidy(name)).casefold())
    return _SUFFIX.sub("", short)


def _only(table: TextTable, condition: str) -> TextTable:
    name, equals, value = condition.partition("=")
    if not equals:
        raise ValueError(f"--where {condition}: expected COLUMN=VALUE, plate=europe.")
    name = find(table, name.strip(), "--where")
    wanted = tidy(value).casefold()
    entries = [tidy(entry).casefold() for entry in table.columns[name]]
    kept = [i for i, entry in enumerate(entries) if entry == wanted]
    if not kept:
        there = sorted(set(entries))
        more = ", ..." if len(there) > 20 else ""
        raise ValueError(
            f"--where {condition}: no such row; `{name}` has "
            f"{', '.join(there[:20])}{more}."
        )
    return table.take(kept)


def _precision(table: TextTable, columns: dict[str, str]) -> tuple[np.ndarray, str]:
    """A95 in degrees, NaN where there is none, and in words."""
    read = lambda role: _positive(table, columns, role)
    a95, k, n, dp, dm = map(read, ("a95", "k", "n", "dp", "dm"))
    ways = {"A95": a95}
    known = np.isfinite(k * n)
    ways["K and N"] = np.full_like(a95, np.nan)
    if known.any():
        ways["K and N"][known] = mr.a95_of(k[known], n[known])
    ways["dp and dm"] = np.sqrt(dp * dm)
    found, words = np.full_like(a95, np.nan), []
    for way, radii in ways.items():
        new = np.isnan(found) & np.isfinite(radii)
        found = np.where(new, radii, found)
        if new.any():
            words.append(f"{way} of {new.sum()}")
    if not words:
        return found, "none given: all poles count alike"
    if without := int(np.sum(np.isnan(found))):
        words.append(
            f"none of {without}: the median of the others, "
            f"{np.nanmedian(found):.3g} degrees"
        )
    return found, ", ".join(words)


def _positive(table: TextTable, columns: dict[str, str], role: str) -> np.ndarray:
    """NaN where there is none; 0, as tables write what is not known, counts as none."""
    if role not in columns:
        return np.full(len(table.rows), np.nan)
    values = numbers_or_nan(table, columns[role], "--column")
    cure = "Mend the row, or leave the number out"
    refuse(table, columns[role], values < 0, f"{role} is not negative", cure)
    return np.where(values > 0, values, np.nan)


def _ages(
    table: TextTable, columns: dict[str, str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Age, both ends of its range and its standard deviation, NaN where not known."""

    def read(role: str) -> np.ndarray:
        if role not in columns:
            return np.full(len(table.rows), np.nan)
        values = numbers_or_nan(table, columns[role], "--column")
        demand = "ages and their errors are not negative (Ma before present)"
        refuse(table, columns[role], values < 0, demand, "Mend the row")
        return values

    age, low, high = map(read, ("age", "age_min", "age_max"))
    sigma, double = read("age_sigma"), read("age_2sigma")
    sigma = np.where(np.isfinite(sigma), sigma, double / 2)
    if "age_min" in columns:
        names = columns["age_min"], columns["age_max"]
        demand = f"{names[0]} must not exceed {names[1]}"
        refuse(table, names[0], low > high, demand, "Exchange both in the row")
        for name, gap, other in zip(names, (low, high), (high, low), strict=True):
            one = np.isnan(gap) & np.isfinite(other)
            demand = f"a range of ages has both ends, {names[0]} and {names[1]}"
            refuse(table, name, one, demand, "Fill in the other, or leave both empty")
        none = np.isnan(age) & np.isnan(low)
        demand = "each row needs an age, or a range"
        refuse(table, names[0], none, demand, "Fill it in, or leave out the row")
    if "distribution" in columns:
        words = [tidy(w).casefold() for w in table.columns[columns["distribution"]]]
        uniform = np.array([word.startswith(("uni", "rect", "flat")) for word in words])
        sigma = np.where(uniform & np.isfinite(low), np.nan, sigma)
    return age, low, high, sigma
