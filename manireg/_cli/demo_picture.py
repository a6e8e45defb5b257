"""The picture of `manireg demo`: poles, their running mean, and the path with its band."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import plot
from .._solver.regions import Region
from ..datasets import PalaeomagneticPoles
from ..plot._figure import STYLE, matplotlib
from ..plot._globe import pale, view_of

DARK = "#33373c"


def draw_poles(
    model: Any,
    region: Region,
    poles: PalaeomagneticPoles,
    pieces: Sequence[np.ndarray],
    name: str,
    out: Path,
) -> None:
    """`pieces`: of a line beside the path, called `name`."""
    with matplotlib().rc_context(STYLE):
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import ListedColormap, Normalize, to_hex
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        ages = np.linspace(poles.ages[0], poles.ages[-1], len(region.theta95))
        path = np.asarray(region.centre)
        dark = ListedColormap(matplotlib().colormaps["viridis"](range(236)))
        colour = ScalarMappable(Normalize(ages[0], ages[-1]), dark)
        drawn = plot.globe(
            plot.figure(4.6, 4.0).add_subplot(), view=view_of(path), graticule=30
        )
        drawn.band(np.asarray(region.outline()), colour.to_rgba(ages))
        faint = {"s": 12, "linewidths": 0, "edgecolors": "none"}
        drawn.points(
            poles.directions, colour.to_rgba(poles.ages), zorder=3, alpha=0.5, **faint
        )
        for piece in pieces:
            drawn.path(piece, DARK, linewidths=0.6)
            drawn.points(piece, DARK, s=5, linewidths=0)
        drawn.path(path, colour.to_rgba(ages), linewidths=2.2)
        bar = drawn.figure.colorbar(
            colour, ax=drawn.axes, shrink=0.7, aspect=25, pad=0.03
        )
        bar.set_label("age (million years)")
        bar.outline.set_linewidth(0.4)
        middle = np.asarray(colour.to_rgba(ages))[[len(ages) // 2]]
        line, band = to_hex(middle[0]), to_hex(pale(middle, 0.35)[0])
        region_of = f"where it is, {100 * region.level:g} %"
        marks = [
            Line2D([], [], color=line, lw=2.2, label="path"),
            Patch(color=band, label=region_of),
            Line2D([], [], color=DARK, lw=0.6, marker=".", ms=4, label=name),
            Line2D(
                [], [], color=line, marker="o", ls="", ms=3, alpha=0.5, label="poles"
            ),
        ]
        row = {"ncols": 4, "columnspacing": 1.2, "handlelength": 1.6}
        drawn.figure.legend(handles=marks, loc="outside lower center", **row)
        plot.save(drawn.figure, out)
