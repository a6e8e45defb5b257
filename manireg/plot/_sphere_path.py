"""A curve on the sphere, with its data and its band."""

from typing import TYPE_CHECKING, Any

import numpy as np

from .._solver.posterior import Posterior
from ..datasets._tables import unit
from ._band import spread_along
from ._figure import GREY, STYLE, ArrayLike, figure, matplotlib
from ._globe import DOT, globe, view_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
else:
    Axes = Figure = Any

LEAST_DOT = 1.5  # area of a datum, in square points
BAND = 200  # regions along a path


def sphere_path(
    model: Any,
    x: ArrayLike,
    y: ArrayLike,
    *,
    a95: ArrayLike | None = None,
    level: float | None = None,
    posterior: Posterior | None = None,
    weights: ArrayLike | None = None,
    view: ArrayLike | None = None,
    label: str = "input",
    ax: Axes | None = None,
) -> Figure:
    """A curve on the sphere S^2: data `y` (k, 3) at scalar inputs `x` (k,), the path of
    `model` between the first and the last, both coloured by the input, and confidence
    circles of radius `a95` (k,) in degrees where it is given. What fills only a small
    part of the sphere is enlarged.

    **Arguments:** `model` any callable from inputs to points, as `fit` returns; `level`
    such as 0.95: the band of the confidence regions of a fitted map (each holds the map at
    its input with that probability), by its `posterior`, default `model.posterior()`;
    `weights` (k,) the areas of the dots, relative to the largest, such as
    `model.data_weights`; `view` the direction towards the eye, by default `view_of` data
    and path; `label` names the input; `ax` the axes to draw in, by default a new figure.

    **Example:**

    ```python
    data = mr.datasets.polar_wander("india")  # 33 poles: ages, unit vectors
    model = mr.fit(mr.Interval(0, 320), mr.Sphere(2), data.ages, data.directions, 1e3)
    picture = mr.plot.sphere_path(model, data.ages, data.directions, a95=data.a95)
    mr.plot.save(picture, "path.pdf")
    ```
    """
    with matplotlib().rc_context(STYLE):
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import ListedColormap, Normalize

        x, y = np.asarray(x), unit(y)
        inputs = np.linspace(x.min(), x.max(), 1500)
        path = np.asarray(model(inputs.reshape(-1, *x.shape[1:])))
        seen = np.concatenate([unit(path[::10]), y])
        outlines = None
        if level is not None:
            at = spread_along(inputs, unit(path), BAND)
            sure: Posterior = posterior or model.posterior()
            region = sure.region(at.reshape(-1, *x.shape[1:]), level)
            outlines = np.asarray(region.outline())
            seen = np.concatenate([seen, unit(outlines[:, ::9].reshape(-1, 3))])
        view = view_of(seen) if view is None else unit(view)
        off_centre = float(np.arccos(np.clip((seen @ view).min(), -1, 1)))
        off_centre += 0.0 if a95 is None else float(np.radians(np.max(np.asarray(a95))))
        radius = 1.1 * np.sin(off_centre) if off_centre < 0.5 else 1.0
        ax = figure(3.6, 3.0).add_subplot() if ax is None else ax
        drawn = globe(ax, view=view, radius=radius)
        dark = ListedColormap(matplotlib().colormaps["viridis"](range(236)))
        colour = ScalarMappable(Normalize(x.min(), x.max()), dark)
        if a95 is not None:
            drawn.circles(y, a95, colour.to_rgba(x.ravel()))
        if outlines is not None:
            drawn.band(outlines, GREY)
        drawn.path(path, colour.to_rgba(inputs))
        sizes = DOT * np.ones(len(y)) if weights is None else _sizes(weights, len(y))
        drawn.points(y, colour.to_rgba(x.ravel()), sizes)
        bar = drawn.figure.colorbar(colour, ax=ax, shrink=0.7, aspect=25, pad=0.03)
        bar.set_label(label)
        bar.outline.set_linewidth(0.4)
        return drawn.figure


def _sizes(weights: ArrayLike, k: int) -> np.ndarray:
    weights = np.asarray(weights, float)
    if weights.shape != (k,):
        raise ValueError(
            f"weights: expected shape ({k},), one for each datum, found {weights.shape}."
        )
    return np.maximum(DOT * weights / np.max(weights), LEAST_DOT)
