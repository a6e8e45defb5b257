"""`manireg fit`."""

import time
from pathlib import Path
from typing import Annotated, Any

import jax
import numpy as np
import typer

import manireg as mr

from .._selection.chosen_fit import chosen_fit
from ..datasets._text_tables import read_text_table
from .arguments import (
    check_not_read,
    check_once,
    inputs_of,
    number_of,
    order_of,
    outputs_of,
    weights_of,
)
from .axes import axis_of, lambda_unit
from .columns import Missing, complete, find
from .errors import check_written, clean_errors
from .noise import (
    A95,
    MIDDLE,
    Criterion,
    Kappa,
    Level,
    Loss,
    NoiseColumns,
    Scattering,
    Sigma,
    Wavelength,
    XMax,
    XMin,
    XSigma,
    check_level,
    loss_of,
)
from .picture import draw
from .queries import asked, grid, rows
from .report import noise_rows, report, theta_row
from .tables import TargetName, read_target, write_table
from .uncertainty import theta, uncertainty

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
        str | None,
        typer.Option(
            help="Input column, of numbers or dates; several, with commas, span a box."
        ),
    ] = None,
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
    sigma: Sigma = None,
    a95: A95 = None,
    kappa: Kappa = None,
    x_sigma: XSigma = None,
    x_min: XMin = None,
    x_max: XMax = None,
    loss: Loss = "squared",
    scatter: Scattering = "additive",
    lam: Annotated[
        str,
        typer.Option(help="Smoothness lambda: a number, or `auto`: see --criterion."),
    ] = "auto",
    wavelength: Wavelength = None,
    criterion: Criterion = "error",
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
    level: Level = 95.0,
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

    Writes predictions in the format of the output columns, with columns that say how
    sure they are, and prints the lambda, its cross-validated error and how data scatter.

    On the sphere these columns are the ellipse that holds the path (not the data about it)
    with --level percent - semi_major, semi_minor and azimuth of the longer axis - and
    theta95, the radius of the circle as large, all in degrees; of one input also its speed
    in degrees per unit of the input (of dates, second), with the standard error se_speed.
    Of other targets they are standard errors: se in degrees for the circle, se_x, se_y,
    se_z in degrees about the axes of space for rotations, se_NAME for each euclidean
    output.

    Tables are text (UTF-8, UTF-16 or Windows-1252) separated by commas, semicolons, tabs,
    `|` or spaces. Lines that start with # or % are comments. Numbers may have decimal
    commas, degree signs and hemispheres (12.5S). Dates are ISO 8601 (2024-05-01T12:30:00Z)
    and count as seconds. Missing is what is empty, NA, nan, null or -. Names of columns
    match without regard to case.

    Examples:

        manireg fit poles.csv --target sphere --input age --lat-lon lat,lon
            --weights precision --picture path.pdf

        manireg fit poles.csv --target sphere --x-min from --x-max to --lat-lon lat,lon
            --a95 a95 --loss huber --criterion reml

        manireg fit imu.csv --target rotations --input time --output qw,qx,qy,qz
            --predict times.csv --out orientation.csv

        manireg fit wind.csv --target circle --input hour --output direction --lam 0.1
    """
    with clean_errors():
        data, out = data.expanduser(), out.expanduser()
        picture = None if picture is None else picture.expanduser()
        check_written(picture, out)
        check_level(level)
        check_not_read(out, data, Path(predict))
        table = read_text_table(data)
        noise = NoiseColumns(sigma, a95, kappa, x_sigma, x_min, x_max).found(table)
        option, outputs = outputs_of(output, lat_lon)
        inputs = [find(table, name, "--input") for name in inputs_of(input, noise)]
        outputs = [find(table, name, option) for name in outputs]
        check_once(inputs + outputs)
        weight = [] if weights is None else [find(table, weights, "--weights")]
        names = [*inputs, *outputs, *weight, *noise.names]
        table = complete(table, names, missing)
        if not inputs:
            table, inputs = noise.with_middle(table), [MIDDLE]
        places = asked(predict, inputs, missing)
        axes = [axis_of(name, [table, *places]) for name in inputs]
        x = np.stack([axis.floats(table) for axis in axes], axis=-1)
        there = read_target(target, table, outputs, lat_lon is not None)
        w = weights_of(table, weight[0]) if weight else None
        queries, texts = rows(places[0], axes) if places else grid(predict, x, axes)
        for axis, values in zip(axes, x.T, strict=True):
            if np.ptp(values) == 0:
                constant = axis.texts(values[:1])[0]
                raise ValueError(
                    f"{data}: input column `{axis.name}` is constant, {constant}."
                )
        of_inputs = noise.of_inputs(table, axes)
        ends = [
            of_inputs[end][:, None] for end in ("x_min", "x_max") if end in of_inputs
        ]
        everything = np.concatenate([x, queries, *ends])
        lower, upper = everything.min(0), everything.max(0)
        one = len(inputs) == 1
        source = mr.Interval(lower[0], upper[0]) if one else mr.Box(lower, upper)
        shape = (-1,) if one else (-1, len(inputs))
        x, queries = x.reshape(shape), queries.reshape(shape)

        start, asked_order = time.perf_counter(), order_of(order)
        given = {"weights": w, "order": asked_order, "loss": loss_of(loss)}
        given |= noise.of_outputs(table, there)
        value = None if lam == "auto" else number_of(lam)
        choice: dict[str, Any] = {"criterion": criterion, **of_inputs}
        choice |= {"wavelength": wavelength}
        if folds is not None:
            choice |= {"folds": min(folds, len(x)), "key": jax.random.key(seed)}
        problem = source, there.manifold, x, there.points
        model, cv = chosen_fit(*problem, value, given, scatter, **choice)
        p = asked_order if cv is None else cv.order
        predicted = np.array(model(queries))
        # a lambda that is given is known
        posterior = model.posterior("known" if cv is None else "auto")
        sure = uncertainty(posterior, target, there, queries, level)
        seconds = time.perf_counter() - start

        values = np.concatenate([there.decode(predicted), sure[1]], axis=1)
        write_table(out, [*inputs, *there.columns, *sure[0]], texts, values)
        written = [out]
        if picture is not None:
            draw(picture, model, posterior, x, there, axes, level)
            written.append(picture)
        summary = f"{len(x)} rows of {data.name}, {', '.join(inputs)} -> {target}"
        more = noise_rows(posterior, there.degrees)
        if theta(level) in sure[0]:
            more |= theta_row(theta(level), sure[1][:, sure[0].index(theta(level))])
        starts = [f"{a.name} in seconds since {a.start}" for a in axes if a.dates]
        more |= {"dates": ", ".join(starts)} if starts else {}
        unit = lambda_unit(axes, p)
        known = summary, model, cv, there.degrees, seconds, written, more
        report(*known, unit, p, criterion)
