"""The picture of `manireg demo`: poles, their running mean, and the path with its band."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import plot
from .._solver.regions import Region
from ..datasets import PalaeomagneticPoles
from ..plot._figure import STYLE, matplotlib
from ..plot._globe import Globe, view_of

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
        _band(drawn, region, colour.to_rgba(ages))
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
        middle: Any = colour.to_rgba(ages)[len(ages) // 2]
        line, band = to_hex(middle), to_hex(_pale(middle))
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


def _band(drawn: Globe, region: Region, colours: np.ndarray) -> None:
    """The regions, one over the other, opaque and without an edge: their union. What of
    one lies beyond the rim of the globe is drawn on it."""
    from matplotlib.collections import PolyCollection

    outlines = np.asarray(region.outline())
    place, near = drawn.flatten(outlines)
    far = np.linalg.norm(place, axis=-1, keepdims=True)
    rim = place / np.maximum(far, 1e-9)
    for front, order in ((True, 1.8), (False, 0.5)):
        own = near if front else ~near
        some = own.any(axis=1)
        shapes = np.where(own[..., None], place, rim)[some]
        shade = _pale(colours[some], 0.35 if front else 0.12)
        drawn.axes.add_collection(
            PolyCollection(list(shapes), facecolors=shade, linewidths=0, zorder=order),
            autolim=False,
        )


def _pale(colour: np.ndarray, share: float = 0.35) -> Any:
    """Mixed with white, opaque."""
    return np.concatenate([1 - share * (1 - colour[..., :3]), colour[..., 3:]], axis=-1)
