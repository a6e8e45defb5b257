"""`manireg fit`."""

import time
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import typer

import manireg as mr

from .. import plot
from .._input.shown import shown
from .._selection.one_fit import STEPS_TO_THE_END
from .._selection.orders import Order
from .._solver.solve import checked
from ..datasets._entries import is_data
from ..datasets._text_tables import TextTable, read_text_table
from .axes import Axis, axis_of, lambda_unit
from .columns import Missing, complete, find, numbers, split_names
from .errors import check_written, clean_errors
from .report import report
from .tables import Target, TargetName, read_target, write_table

Folds = Annotated[
    int | None,
    typer.Option(
        min=2,
        help="Choose lambda by cross-validation with so many folds; by default each row "
        "is left out in turn.",
    ),
]
Seed = Annotated[int, typer.Option(help="Seed of the random folds.")]


def fit(
    data: Annotated[Path, typer.Argument(help="A table as text, with a header line.")],
    target: Annotated[
        TargetName,
        typer.Option(
            help="Where the outputs live. `sphere`: unit vectors, or --lat-lon; "
            "`rotations`: quaternion w,x,y,z, or nine matrix entries row by row; "
            "`circle`: one angle in degrees; `euclidean`: any numbers."
        ),
    ],
    input: Annotated[
        str,
        typer.Option(
            help="Input column, of numbers or dates; several, with commas, span a box."
        ),
    ],
    output: Annotated[
        str | None, typer.Option(help="Output columns, with commas.")
    ] = None,
    lat_lon: Annotated[
        str | None,
        typer.Option(help="Latitude and longitude columns in degrees, for the sphere."),
    ] = None,
    weights: Annotated[
        str | None, typer.Option(help="Column of weights, 1/variance; positive.")
    ] = None,
    lam: Annotated[
        str,
        typer.Option(help="Smoothness lambda: a number, or `auto`: cross-validated."),
    ] = "auto",
    order: Annotated[
        str,
        typer.Option(
            help="Of the derivatives that are kept small: 2 (bending), 1, 3 or 4; several "
            "with commas, or `auto`, to choose from."
        ),
    ] = "2",
    predict: Annotated[
        str,
        typer.Option(
            help="Where to predict: about how many points of a grid over the data, "
            "or a table with the input columns."
        ),
    ] = "200",
    out: Annotated[Path, typer.Option(help="CSV file of the predictions.")] = Path(
        "predictions.csv"
    ),
    picture: Annotated[
        Path | None,
        typer.Option(help="Also draw data and fit (one or two inputs): PNG, PDF, SVG."),
    ] = None,
    missing: Annotated[
        Missing,
        typer.Option(
            help="What to do with rows that lack a value: `drop` them and say which, or "
            "end with an `error`."
        ),
    ] = Missing.drop,
    folds: Folds = None,
    seed: Seed = 0,
) -> None:
    """Fit a smooth map into a manifold to the rows of a table.

    Writes predictions in the format of the output columns, and prints the lambda and
    its cross-validated error.

    Tables are text (UTF-8, UTF-16 or Windows-1252) separated by commas, semicolons, tabs,
    `|` or spaces. Lines that start with # or % are comments. Numbers may have decimal
    commas, degree signs and hemispheres (12.5S). Dates are ISO 8601 (2024-05-01T12:30:00Z)
    and count as seconds. Missing is what is empty, NA, nan, null or -. Names of columns
    match without regard to case.

    Examples:

        manireg fit poles.csv --target sphere --input age --lat-lon lat,lon
            --weights precision --picture path.pdf

        manireg fit imu.csv --target rotations --input time --output qw,qx,qy,qz
            --predict times.csv --out orientation.csv

        manireg fit wind.csv --target circle --input hour --output direction --lam 0.1
    """
    with clean_errors():
        data, out = data.expanduser(), out.expanduser()
        picture = None if picture is None else picture.expanduser()
        check_written(picture, out)
        _check_not_read(out, data, Path(predict))
        table = read_text_table(data)
        option, outputs = _outputs(output, lat_lon)
        inputs = [find(table, name, "--input") for name in split_names(input)]
        outputs = [find(table, name, option) for name in outputs]
        _check_once(inputs + outputs)
        weight = [] if weights is None else [find(table, weights, "--weights")]
        table = complete(table, [*inputs, *outputs, *weight], missing)
        asked = [] if predict.isdecimal() else [_asked(predict, inputs, missing)]
        axes = [axis_of(name, [table, *asked]) for name in inputs]
        x = np.stack([axis.floats(table) for axis in axes], axis=-1)
        there = read_target(target, table, outputs, lat_lon is not None)
        w = _weights(table, weight[0]) if weight else None
        queries, texts = _queries(asked[0], axes) if asked else _grid(predict, x, axes)
        for axis, values in zip(axes, x.T, strict=True):
            if np.ptp(values) == 0:
                constant = axis.texts(values[:1])[0]
                raise ValueError(
                    f"{data}: input column `{axis.name}` is constant, {constant}."
                )
        everything = np.concatenate([x, queries])
        lower, upper = everything.min(0), everything.max(0)
        one = len(inputs) == 1
        source = mr.Interval(lower[0], upper[0]) if one else mr.Box(lower, upper)
        shape = (-1,) if one else (-1, len(inputs))
        problem = source, there.manifold, x.reshape(shape), there.points

        start, cv, p = time.perf_counter(), None, _order(order)
        if lam == "auto":
            cv = chosen(problem, w, folds, seed, p)
            model, p = checked(cv.model, STEPS_TO_THE_END), cv.order
        else:
            model = mr.fit(*problem, _number(lam), weights=w, order=p)
        predicted = np.array(model(queries.reshape(shape)))
        seconds = time.perf_counter() - start

        write_table(out, [*inputs, *there.columns], texts, there.decode(predicted))
        written = [out]
        if picture is not None:
            _draw(picture, model, x.reshape(shape), there, axes)
            written.append(picture)
        summary = f"{len(x)} rows of {data.name}, {', '.join(inputs)} -> {target}"
        starts = [f"{a.name} in seconds since {a.start}" for a in axes if a.dates]
        more = {"dates": ", ".join(starts)} if starts else {}
        unit = lambda_unit(axes, p)
        report(summary, model, cv, there.degrees, seconds, written, more, unit, p)


def chosen(
    problem, w, folds: int | None, seed: int, order: Order = 2
) -> mr.CrossValidation:
    """Lambda, by leaving out each row or so many folds of them."""
    options: dict[str, Any] = {"weights": w, "order": order}
    if folds is None:
        return mr.leave_one_out(*problem, **options)
    key, folds = jax.random.key(seed), min(folds, len(problem[2]))
    return mr.cross_validate(*problem, folds=folds, key=key, **options)


def _check_not_read(out: Path, *tables: Path) -> None:
    for table in tables:
        table = table.expanduser()
        if out.exists() and table.exists() and out.samefile(table):
            raise ValueError(f"--out {out} is a table to read; name another file.")


def _outputs(output: str | None, lat_lon: str | None) -> tuple[str, list[str]]:
    if output is not None and lat_lon is None:
        return "--output", split_names(output)
    if lat_lon is not None and output is None:
        return "--lat-lon", split_names(lat_lon)
    raise ValueError("Give either --output or --lat-lon, the output columns.")


def _check_once(names: list[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"--input, --output: column `{name}` is named twice.")


def _weights(table: TextTable, name: str) -> np.ndarray:
    w = numbers(table, [name], "--weights")[:, 0]
    bad = np.flatnonzero(w <= 0)
    if bad.size:
        first = int(bad[0])
        raise ValueError(
            f"{table.path}: weights must be positive, but column `{name}` has "
            f"{shown(w[first])} in data row {table.rows[first]}. Remove the row (line "
            f"{table.lines[first]}) or give a small weight."
        )
    return w


def _number(lam: str) -> float:
    try:
        return float(lam)
    except ValueError:
        raise ValueError(f"--lam is a number or auto, found {lam!r}.") from None


def _order(order: str) -> Any:
    """A number, several, or `auto`."""
    if order == "auto":
        return order
    try:
        several = tuple(int(p) for p in order.split(","))
    except ValueError:
        raise ValueError(
            f"--order is 1, 2, 3 or 4, several with commas, or auto, found {order!r}."
        ) from None
    return several[0] if len(several) == 1 else several


def _asked(predict: str, inputs: list[str], missing: Missing) -> TextTable:
    """The table of inputs to predict at."""
    file = Path(predict).expanduser()
    if not file.is_file() and is_data(predict):
        raise ValueError(f"--predict {predict} is no whole number, and no such file.")
    table = read_text_table(file)
    return complete(table, [find(table, n, "--input") for n in inputs], missing)


def _queries(table: TextTable, axes: list[Axis]) -> tuple[np.ndarray, list[list[str]]]:
    """Inputs (n, m) to predict at, the rows of a file, and their texts, as given."""
    floats = np.stack([axis.floats(table) for axis in axes], axis=-1)
    return floats, [axis.given(table) for axis in axes]


def _grid(predict: str, x: np.ndarray, axes: list[Axis]):
    """The same for a grid over the data."""
    each = max(2, round(int(predict) ** (1 / len(axes))))
    ticks = [np.linspace(a, b, each) for a, b in zip(x.min(0), x.max(0), strict=True)]
    grid = np.meshgrid(*ticks, indexing="ij")
    floats = np.stack(grid, axis=-1).reshape(-1, len(axes))
    texts = [axis.texts(column) for axis, column in zip(axes, floats.T, strict=True)]
    return floats, texts


def _draw(path: Path, model: Any, x: np.ndarray, there: Target, axes: list[Axis]):
    y, one = there.points, x.ndim == 1
    names = there.columns if y[0].size == len(there.columns) else None
    labels = tuple(axis.label for axis in axes)
    if one and isinstance(there.manifold, mr.Sphere) and there.manifold.dim == 2:
        picture = plot.sphere_path(model, x, y, label=labels[0])
    elif one and len(there.columns) < y[0].size == 2:
        picture = plot.coordinates(
            *_unwrapped(model, x, there),
            names=(f"{there.columns[0]} (degrees)",),
            label=labels[0],
        )
    else:
        picture = plot.coordinates(model, x, y, names=names, label=labels)
    plot.save(picture, path)


def _unwrapped(model: Any, x: np.ndarray, there: Target):
    """Model, inputs and data of a circle as angles in degrees that do not jump."""

    def angle(t):
        return np.unwrap(there.decode(np.asarray(model(t)))[:, 0], period=360)

    grid = np.linspace(x.min(), x.max(), 500)
    fitted = np.interp(x, grid, angle(grid))
    return (
        angle,
        x,
        fitted + (there.decode(there.points)[:, 0] - fitted + 180) % 360 - 180,
    )
