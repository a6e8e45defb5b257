"""`manireg demo`."""

import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from jaxtyping import Float

import manireg as mr

from .. import datasets
from .._input.shown import shown
from .._selection.chosen_fit import chosen_fit
from .._selection.criteria import CriterionName
from ..datasets import PalaeomagneticPoles
from ..datasets._tables import unit
from .demo_picture import draw_poles
from .errors import check_written, clean_errors
from .noise import LossName, loss_of
from .report import noise_rows, report, theta_row

LOSS: LossName = "squared"
CRITERION: CriterionName = "reml"
LEVEL = 0.95
LEAST = 15  # poles of a plate that make a path
WINDOW, STEP = 20.0, 10.0  # of the running mean, million years


def demo(
    plate: Annotated[
        str,
        typer.Option(
            help=f"One of {', '.join(datasets.palaeomagnetic_plates(LEAST))}."
        ),
    ] = "gondwana",
    out: Annotated[
        Path, typer.Option(help="Where the picture goes: PNG, PDF or SVG.")
    ] = Path("demo.png"),
) -> None:
    """Draw the apparent polar wander path of a continent, and how sure it is.

    The 194 palaeomagnetic poles of Gondwana over 550 million years, each with its
    confidence cone (Torsvik et al. 2012), become a curve on the sphere: time -> S^2.
    Precise poles count more, but they scatter more than their cones say: how much, and how
    smooth the curve is, the restricted likelihood of all poles tells. Beside it the
    picture has the running mean of the same poles.
    """
    with clean_errors():
        out, plate = out.expanduser(), plate.lower()
        check_written(out)
        poles = _poles(plate)
        start = time.perf_counter()
        x, y = poles.ages, poles.directions
        source = mr.Interval(x[0], x[-1])
        given = {"sigma": mr.from_a95(poles.a95), "loss": loss_of(LOSS)}
        problem = source, mr.Sphere(2), x, y
        model, cv = chosen_fit(*problem, None, given, criterion=CRITERION)
        posterior = model.posterior()
        ages = np.linspace(x[0], x[-1], 300)
        region = posterior.region(ages, LEVEL)
        seconds = time.perf_counter() - start
        name = f"running mean, {WINDOW:g} million years"
        draw_poles(model, region, poles, running_mean(poles), name, out)
        data = (
            f"{len(x)} poles of {plate}, {shown(x[0])} to {shown(x[-1])} million years"
        )
        more = noise_rows(posterior, np.degrees(1.0))
        more |= theta_row(f"theta{100 * LEVEL:g}", region.theta95)
        fitted = model, cv, np.degrees(1.0), seconds
        report(data, *fitted, [out], more, criterion=CRITERION)


def running_mean(
    poles: PalaeomagneticPoles, window: float = WINDOW, step: float = STEP
) -> list[Float[np.ndarray, "m 3"]]:
    """Fisher's means, directions of the sums, of the poles within half a window of ages
    a step apart; a new piece after an age with less than three."""
    first, last = np.ceil(poles.ages[[0, -1]] / step)
    pieces = [[]]
    for age in step * np.arange(first, last):
        inside = poles.directions[np.abs(poles.ages - age) <= window / 2]
        if len(inside) >= 3:
            pieces[-1].append(unit(inside.sum(0)))
        elif pieces[-1]:
            pieces.append([])
    return [np.stack(piece) for piece in pieces if piece]


def _poles(plate: str) -> PalaeomagneticPoles:
    """Of a plate that has enough of them; those of unknown precision are left out."""
    plates = datasets.palaeomagnetic_plates(LEAST)
    if plate not in plates:
        raise ValueError(
            f"No plate {plate!r} with {LEAST} poles; there are: {', '.join(plates)}."
        )
    poles = datasets.palaeomagnetic_poles(plate)
    known = np.isfinite(poles.a95)
    return datasets.PalaeomagneticPoles(*(column[known] for column in poles))
