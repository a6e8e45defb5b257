"""The command line: `manireg demo`, `manireg fit` and `manireg register`."""

import contextlib
import os
import time
from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import typer

import manireg as mr

from .. import datasets, plot
from .._input.shown import shown
from .errors import check_written, clean_errors
from .fit import Folds, Seed, chosen, fit
from .register import register
from .report import report

app = typer.Typer(
    name="manireg",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_show_locals=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

app.command()(fit)
app.command()(register)


def main() -> None:
    app()


@app.callback()
def setup(
    cache: Annotated[
        bool,
        typer.Option(help="Keep compiled programs for later commands, up to 256 MiB."),
    ] = True,
) -> None:
    """Regression between Riemannian manifolds with the Eells energy.

    Start with `manireg demo`, then `manireg fit --help` for tables and `manireg register
    --help` for scanned surfaces.
    """
    jax.config.update("jax_enable_x64", True)
    # a device a core, to share the folds; too late where JAX has run in this process
    with contextlib.suppress(RuntimeError):
        jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)
    if not cache:
        jax.config.update("jax_enable_compilation_cache", False)
    with clean_errors():
        mr.cache_programs()


@app.command()
def demo(
    plate: Annotated[
        str,
        typer.Option(help=f"One of {', '.join(datasets.polar_wander_plates())}."),
    ] = "india",
    out: Annotated[
        Path, typer.Option(help="Where the picture goes: PNG, PDF or SVG.")
    ] = Path("demo.png"),
    folds: Folds = None,
    seed: Seed = 0,
) -> None:
    """Draw the apparent polar wander path of a tectonic plate.

    33 mean poles over 320 million years, each with its confidence cone (Torsvik et al.
    2008), are smoothed into a curve on the sphere: time -> S^2. Precise poles count
    more. How smooth the curve is, cross-validation chooses on every second pole: the
    poles are running means, so neighbours share data and would not be independent.
    """
    with clean_errors():
        out = out.expanduser()
        check_written(out)
        path = datasets.polar_wander(plate)
        x, y, w = path.ages, path.directions, path.weights
        problem = mr.Interval(x[0], x[-1]), mr.Sphere(2), x, y
        sphere, start = problem[1], time.perf_counter()
        # weights, not fewer data: the fit to all of them has the same shapes, and programs
        every_second = np.where(np.arange(len(x)) % 2 == 0, w, 0.0)
        cv = chosen(problem, every_second, folds, seed)
        model = mr.fit(*problem, cv.lam, weights=w)
        error = np.degrees(
            np.sqrt(sphere.squared_distance(model(x), jax.device_put(y)))
        )
        seconds = time.perf_counter() - start
        picture = plot.sphere_path(
            model, x, y, a95=path.a95, label="age (million years)"
        )
        plot.save(picture, out)
        data = f"{len(x)} poles of {plate}, 0 to {shown(x[-1])} million years ago"
        inside = f"{np.sum(error < path.a95)} of {len(x)} poles"
        cones = {"path inside the 95 % cone of": inside}
        report(data, model, cv, np.degrees(1.0), seconds, [out], cones)
