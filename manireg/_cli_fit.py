"""`manireg fit`."""

import time
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import typer

import manireg as mr

from . import datasets, plot
from ._cli_errors import check_written, clean_errors
from ._cli_report import report
from ._cli_tables import Columns, Target, TargetName, numbers, read_target, write_table

Folds = Annotated[int, typer.Option(min=2, help="Folds of the cross-validation.")]
Seed = Annotated[int, typer.Option(help="Seed of the random folds.")]


def fit(
    data: Annotated[Path, typer.Argument(help="CSV file with a header line.")],
    target: Annotated[
        TargetName,
        typer.Option(
            help="Where the outputs live. `sphere`: unit vectors, or --lat-lon; "
            "`rotations`: quaternion w,x,y,z, or nine matrix entries row by row; "
            "`circle`: one angle in degrees; `euclidean`: any numbers."
        ),
    ],
    input: Annotated[
        str, typer.Option(help="Input column; several, with commas, span a box.")
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
        typer.Option(help="Smoothness lambda: a number, or `auto`: cross-validation."),
    ] = "auto",
    predict: Annotated[
        str,
        typer.Option(
            help="Where to predict: about how many points of a grid over the data, "
            "or a CSV file with the input columns."
        ),
    ] = "200",
    out: Annotated[Path, typer.Option(help="CSV file of the predictions.")] = Path(
        "predictions.csv"
    ),
    picture: Annotated[
        Path | None,
        typer.Option(help="Also draw data and fit (one or two inputs): PNG, PDF, SVG."),
    ] = None,
    folds: Folds = 10,
    seed: Seed = 0,
) -> None:
    """Fit a smooth map into a manifold to the rows of a table.

    Writes predictions in the format of the output columns, and prints the lambda and
    its cross-validated error.

    Examples:

        manireg fit poles.csv --target sphere --input age --lat-lon lat,lon
            --weights precision --picture path.pdf

        manireg fit imu.csv --target rotations --input time --output qw,qx,qy,qz
            --predict times.csv --out orientation.csv

        manireg fit wind.csv --target circle --input hour --output direction --lam 0.1
    """
    with clean_errors():
        check_written(picture, out)
        table = datasets.read_table(data)
        inputs = _names(input)
        x = numbers(table, inputs, "--input", data)
        if (output is None) == (lat_lon is None):
            raise ValueError("Give either --output or --lat-lon, the output columns.")
        outputs = _names(output if lat_lon is None else lat_lon)
        there = read_target(target, table, outputs, lat_lon is not None, data)
        w = None if weights is None else _weights(table, weights, data)
        queries = _queries(predict, x, inputs)
        everything = np.concatenate([x, queries])
        lower, upper = everything.min(0), everything.max(0)
        for name, low, high in zip(inputs, lower, upper, strict=True):
            if low == high:
                raise ValueError(f"{data}: input column `{name}` is constant, {low:g}.")
        one = len(inputs) == 1
        source = mr.Interval(lower[0], upper[0]) if one else mr.Box(lower, upper)
        shape = (-1,) if one else (-1, len(inputs))
        problem = source, there.manifold, x.reshape(shape), there.points

        start, cv = time.perf_counter(), None
        if lam == "auto":
            key, folds = jax.random.key(seed), min(folds, len(x))
            cv = mr.cross_validate(*problem, folds=folds, key=key, weights=w)
            model = cv.model
        else:
            model = mr.fit(*problem, _number(lam), weights=w)
        predicted = np.array(model(queries.reshape(shape)))
        seconds = time.perf_counter() - start

        rows = np.concatenate([queries, there.decode(predicted)], axis=-1)
        write_table(out, [*inputs, *there.columns], rows)
        written = [out]
        if picture is not None:
            _draw(picture, model, x.reshape(shape), there, inputs)
            written.append(picture)
        summary = f"{len(x)} rows of {data.name}, {input} -> {target}"
        report(summary, model, cv, there.degrees, seconds, written)


def _names(columns: str | None) -> list[str]:
    return [name.strip() for name in (columns or "").split(",")]


def _weights(table: Columns, name: str, file: Path) -> np.ndarray:
    w = numbers(table, [name], "--weights", file)[:, 0]
    if w.min() <= 0:
        raise ValueError(
            f"{file}: weights must be positive, but column `{name}` has {w.min():g} in "
            f"data row {np.argmin(w) + 1}. Remove the row or give a small weight."
        )
    return w


def _number(lam: str) -> float:
    try:
        return float(lam)
    except ValueError:
        raise ValueError(f"--lam is a number or auto, found {lam!r}.") from None


def _queries(predict: str, x: np.ndarray, inputs: list[str]) -> np.ndarray:
    """Inputs (n, m) to predict at: a grid over the data, or the rows of a file."""
    if not predict.isdecimal():
        file = Path(predict)
        return numbers(datasets.read_table(file), inputs, "--input", file)
    each = max(2, round(int(predict) ** (1 / len(inputs))))
    axes = [np.linspace(a, b, each) for a, b in zip(x.min(0), x.max(0), strict=True)]
    grid = np.meshgrid(*axes, indexing="ij")
    return np.stack(grid, axis=-1).reshape(-1, len(inputs))


def _draw(path: Path, model: Any, x: np.ndarray, there: Target, inputs: list[str]):
    y, one = there.points, x.ndim == 1
    names = there.columns if y[0].size == len(there.columns) else None
    if one and isinstance(there.manifold, mr.Sphere) and there.manifold.dim == 2:
        picture = plot.sphere_path(model, x, y, label=inputs[0])
    elif one and len(there.columns) < y[0].size == 2:
        picture = plot.coordinates(
            *_unwrapped(model, x, there),
            names=(f"{there.columns[0]} (degrees)",),
            label=inputs[0],
        )
    else:
        picture = plot.coordinates(model, x, y, names=names, label=tuple(inputs))
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
