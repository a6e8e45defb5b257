"""Figures that belong to no pyplot, and their style."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jaxtyping

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
else:
    Axes = Figure = Any

ArrayLike = Sequence[Any] | jaxtyping.ArrayLike

STYLE: dict[Any, Any] = {
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "legend.frameon": False,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
}
BLUE, ORANGE, GREY = "#0072B2", "#D55E00", "#7a7f85"  # Okabe & Ito
COLOURS = BLUE, "#009E73", "#CC79A7", GREY  # of curves beside each other


def matplotlib():
    """The package matplotlib; where it is missing, an error that says the cure."""
    try:
        import matplotlib
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "manireg.plot needs matplotlib: pip install 'manireg[plots]'"
        ) from error
    return matplotlib


def figure(width: float = 3.5, height: float = 3.0) -> Figure:
    """An empty figure, in inches, that belongs to no pyplot."""
    matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    class Picture(Figure):
        def _repr_png_(self):
            import io

            with io.BytesIO() as file:
                self.savefig(file, format="png", dpi=144)
                return file.getvalue()

    picture = Picture(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(picture)
    return picture


def save(picture: Figure, path: Any) -> None:
    """Write `picture` for print: 300 dots per inch, cropped, text as text in PDF and
    SVG; the ending of `path` chooses the format."""
    with matplotlib().rc_context(STYLE):
        picture.savefig(path, dpi=300, bbox_inches="tight", pad_inches=0.03)


def figure_of(ax: Axes) -> Figure:
    picture = ax.get_figure(root=True)
    assert picture is not None
    return picture
