"""`manireg path`."""

import time
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

import manireg as mr

from .. import plot
from .._input.shown import shown
from ..apps._path import PolePath, check_site
from ..apps._rotations import check_plates
from ..datasets._text_tables import read_text_table
from .arguments import check_not_read, number_of, order_of
from .columns import Missing
from .errors import check_written, clean_errors
from .noise import Criterion, Level, Loss, Scattering, check_level, loss_of
from .poles import PoleTable, read_poles
from .report import noise_rows, report, theta_row
from .tables import write_table
from .uncertainty import theta

SPIN_AXIS = 0  # the plate that does not move
DEGREES = float(np.degrees(1.0))


class Flip(StrEnum):
    auto = "auto"
    none = "none"


class Projection(StrEnum):
    globe = "globe"
    polar = "polar"


def path(
    data: Annotated[Path, typer.Argument(help="A table of poles, with a header line.")],
    lat_lon: Annotated[
        str | None,
        typer.Option(help="The columns of the pole, where there are several pairs."),
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(help="A column of an unusual name, such as age=T; repeat it."),
    ] = None,
    where: Annotated[
        list[str] | None,
        typer.Option(
            help="Only rows with this entry, such as plate=europe; repeat it."
        ),
    ] = None,
    south: Annotated[
        bool | None,
        typer.Option(
            "--south/--north",
            help="Which poles these are, for --rot; by default what is nearer at the "
            "youngest end. The path is written as the table has it.",
        ),
    ] = None,
    flip: Annotated[
        Flip,
        typer.Option(
            help="`auto` turns poles round that lie more than 90 degrees from the path "
            "around them, and names them; `none` takes them as they are."
        ),
    ] = Flip.auto,
    missing_age_sigma: Annotated[
        float,
        typer.Option(
            help="Standard deviation, Myr, of ages without a range or one of their own; "
            "0: exact."
        ),
    ] = 0.0,
    lam: Annotated[
        str, typer.Option(help="Smoothness lambda: a number, or `auto`.")
    ] = "auto",
    wavelength: Annotated[
        float | None,
        typer.Option(
            help="Instead: in Myr, of which waves keep half of their height, longer ones "
            "more."
        ),
    ] = None,
    criterion: Criterion = "reml",
    scatter: Scattering = "additive",
    loss: Loss = "squared",
    order: Annotated[
        str, typer.Option(help="Of the derivatives that are kept small; see `fit`.")
    ] = "2",
    ages: Annotated[
        str | None, typer.Option(help="Of the table, Ma: from,to,step.")
    ] = None,
    age_step: Annotated[
        float | None,
        typer.Option(help="Myr from age to age; by default for at most 60 ages."),
    ] = None,
    site: Annotated[
        str | None,
        typer.Option(
            help="Latitude,longitude today of where cm_per_year is; by default 90 degrees "
            "from the Euler pole, where the plate is fastest."
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="CSV file of the path.")] = Path("path.csv"),
    rot: Annotated[
        Path | None,
        typer.Option(help="Also a GPlates rotation file (.rot) of the plate."),
    ] = None,
    plate_id: Annotated[
        int, typer.Option(help="Of the plate in it; 0 is the spin axis.")
    ] = 1,
    picture: Annotated[
        Path | None,
        typer.Option(help="Also draw poles, path and rate: PNG, PDF or SVG."),
    ] = None,
    projection: Annotated[
        Projection,
        typer.Option(help="The globe, or a hemisphere about the pole, equal-area."),
    ] = Projection.globe,
    level: Level = 95.0,
    missing: Annotated[
        Missing,
        typer.Option(help="Rows without a pole: `drop` and name them, or an `error`."),
    ] = Missing.drop,
) -> None:
    """Draw the apparent polar wander path of palaeomagnetic poles, and how sure it is.

    Columns are found by their usual names: age, or min_age and max_age, and age_sigma, in
    Ma; lat and lon, plat and plon; A95, else K and N, else dp and dm. An age with a
    standard deviation is normal, one with a range uniform in it, one alone exact, unless
    --missing-age-sigma; within these the poles find their ages with the path. Poles
    scatter more than A95 says; how much is found, and the smoothness by restricted
    likelihood.

    Writes for each age the path (lat, lon), theta95 and its ellipse, the rate in degrees
    per Myr and its standard deviation, the plate's speed in cm per year, the azimuth in
    which the pole moves as time goes on, the Euler (stage) pole about which the plate
    turns with the theta95 of that, how many poles lie within the smoother's window, how
    many it effectively rests on, and its width in Myr.

    --rot has at each age the rotation that carries the path to the geographic pole along
    the great circle: palaeolongitude by the convention of no rotation about the pole.

    Examples:

        manireg path poles.csv --picture path.pdf --rot path.rot --plate-id 701

        manireg path poles.csv --lat-lon plat,plon --wavelength 40 --ages 0,320,10
    """
    with clean_errors():
        data, out = data.expanduser(), out.expanduser()
        picture = None if picture is None else picture.expanduser()
        rot = None if rot is None else rot.expanduser()
        files = [out] if rot is None else [out, rot]
        check_written(picture, *files)
        for file in files:
            check_not_read(file, data)
        check_level(level)
        check_plates(plate_id, SPIN_AXIS)
        place = None if site is None else _pair(site)
        table = read_text_table(data)
        read = read_poles(table, lat_lon, column or [], where or [], missing)
        start = time.perf_counter()
        found = mr.apps.path(
            read.poles,
            ages=None if ages is None else _range(ages),
            age_step=age_step,
            flip=flip.value,
            hemisphere=None if south is None else "south" if south else "north",
            missing_age_sigma=missing_age_sigma,
            lam=None if lam == "auto" else number_of(lam),
            wavelength=wavelength,
            criterion=criterion,
            scatter=scatter,
            loss=loss_of(loss),
            order=order_of(order),
        )
        columns = found.table(site=place, level=level / 100)
        seconds = time.perf_counter() - start
        texts = [[shown(age) for age in columns["age"]]]
        values = np.stack([columns[name] for name in columns][1:], axis=1)
        write_table(out, list(columns), texts, values)
        if rot is not None:
            rot.write_text(found.gplates(plate_id=plate_id, fixed_id=SPIN_AXIS))
        if picture is not None:
            drawn = found.picture(projection=projection.value, level=level / 100)
            plot.save(drawn, picture)
            files.append(picture)
        more = _rows(read, found, columns, site)
        more |= noise_rows(found.posterior, DEGREES)
        more["wavelength"] += " Myr"
        more |= theta_row(theta(level), columns[theta(level)])
        low, high = shown(found.poles.age.min()), shown(found.poles.age.max())
        summary = f"{len(found.poles.age)} poles of {data.name}, {low} to {high} Ma"
        p = found.model.problem.energy.order
        fitted = found.model, found.choice, DEGREES, seconds
        report(summary, *fitted, files, more, order=p, criterion=criterion)


def _rows(
    read: PoleTable, found: PolePath, columns: dict[str, np.ndarray], site: str | None
) -> dict[str, str]:
    """What was read, and what was made of it."""
    poles = found.poles
    used = [f"{role} `{name}`" for role, name in read.columns.items() if role != "name"]
    rows = {"columns": ", ".join(used)}
    exact = int(np.sum(poles.alone))
    deviation = float(np.max(poles.age_sigma[poles.alone], initial=0.0))
    alone = f"standard deviation {deviation:g} Myr" if deviation else "taken as exact"
    kinds = {
        "within a range": int(np.sum(np.isfinite(poles.age_min))),
        "with a standard deviation": int(np.sum(poles.age_sigma >= 0)) - exact,
        f"alone, {alone}": exact,
    }
    rows["ages"] = ", ".join(f"{n} {kind}" for kind, n in kinds.items() if n)
    if np.any(poles.moved):
        moved = np.flatnonzero(poles.moved)
        rows["ages outside their range"] = (
            f"{len(moved)}, taken at its nearer end: {read.named(moved)}"
        )
    rows["precision"] = read.precision
    flipped = np.flatnonzero(found.flipped)
    turned = f", {len(flipped)} turned round: {read.named(flipped)}"
    rows["polarity"] = f"{found.hemisphere} poles{turned if len(flipped) else ''}"
    where = "90 degrees from the Euler pole" if site is None else f"at {site}"
    rows["cm_per_year"] = where
    each = f"{columns['window'].min():.3g} to {columns['window'].max():.3g} Myr"
    behind = columns["effective_poles"]
    rows["window"] = (
        f"{each}, effectively {behind.min():.3g} to {behind.max():.3g} poles"
    )
    return rows


def _pair(site: str) -> tuple[float, float]:
    try:
        lat, lon = map(float, site.split(","))
    except ValueError:
        raise ValueError(
            f"--site takes a latitude and a longitude, such as -33,18; found {site}."
        ) from None
    check_site((lat, lon))
    return lat, lon


def _range(ages: str) -> np.ndarray:
    try:
        first, last, step = map(float, ages.split(","))
    except ValueError:
        raise ValueError(
            f"--ages takes from,to,step in Ma, such as 0,320,10; found {ages}."
        ) from None
    if not (0 <= first <= last and step > 0):
        raise ValueError(
            f"--ages {ages}: from is 0 or more, to not less, step positive."
        )
    count = int(np.floor((last - first) / step + 1e-6))
    return first + step * np.arange(count + 1)
