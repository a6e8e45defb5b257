"""Cross-validation curves, and coordinates against inputs."""

from typing import TYPE_CHECKING, Any

import numpy as np

from .._solver.posterior import Posterior
from .._solver.regions import quantile_radius
from ._figure import (
    BLUE,
    COLOURS,
    ORANGE,
    STYLE,
    ArrayLike,
    figure,
    figure_of,
    matplotlib,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
else:
    Axes = Figure = Any

BAND = 200  # inputs of a band


def cv_curve(cv: Any, *, ax: Axes | None = None) -> Figure:
    """Mean held-out score over the folds against lambda, with its standard error, and
    the lambda chosen; `cv` as `cross_validate` returns it, or a baseline. Where several
    orders were tried, all of their paths, against the wavelength of lambda. Lambdas that
    were not tried (score infinity) are left out."""
    with matplotlib().rc_context(STYLE):
        ax = figure(3.4, 2.3).add_subplot() if ax is None else ax
        paths = getattr(cv, "paths", {})
        if len(paths) < 2:
            ends = [_score_curve(ax, cv, np.asarray(cv.lams), BLUE, None)]
            chosen, label = float(cv.lam), rf"$\lambda = {float(cv.lam):.2g}$"
            ax.set(xlabel=r"$\lambda$")
        else:
            ends = [
                _score_curve(ax, path, np.asarray(path.wavelengths), colour, p)
                for colour, (p, path) in zip(COLOURS, paths.items())
            ]
            chosen = float(cv.wavelengths[cv.chosen])
            label = rf"order {cv.order}, $\lambda = {float(cv.lam):.2g}$"
            ax.set(xlabel="wavelength")
        lows, means, highs = zip(*ends)
        low, most = min(lows), max(highs)
        ax.axvline(chosen, color=ORANGE, lw=1, ls="--", zorder=0, label=label)
        ax.set(xscale="log", ylabel="mean held-out error")
        if most > 10 * min(means):
            ax.set(yscale="log", ylim=(low / 1.3, 1.3 * most))
        ax.legend()
        return figure_of(ax)


def _score_curve(
    ax: Axes, cv: Any, at: np.ndarray, colour: str, order: int | None
) -> tuple[float, float, float]:
    """Drawn; the least end of a bar above 0, the least mean and the largest end."""
    scores, ascending = np.asarray(cv.scores), np.argsort(at)
    tried = ascending[np.isfinite(scores[:, ascending]).all(0)]
    at, scores = at[tried], scores[:, tried]
    mean = scores.mean(0)
    error = scores.std(0, ddof=1) / np.sqrt(len(scores))
    style = {"fmt": "o-", "ms": 3, "lw": 1, "elinewidth": 0.7, "capsize": 1.5}
    label = None if order is None else f"order {order}"
    ax.errorbar(at, mean, error, color=colour, label=label, **style)
    positive = (mean - error)[mean > error]
    return positive.min(initial=mean.min()), mean.min(), (mean + error).max()


def coordinates(
    model: Any,
    x: ArrayLike,
    y: ArrayLike,
    *,
    names: tuple[str, ...] | None = None,
    label: str | tuple[str, ...] = "input",
    level: float | None = None,
    posterior: Posterior | None = None,
) -> Figure:
    r"""Each coordinate of data `y` (k, ...) and `model` against one or two inputs `x`,
    (k,) or (k, 2), a panel each: curves for one input, maps for two, with the data as
    dots in the same colours. `names` of the coordinates, `label` of the inputs.

    `level`, such as 0.95, for one input and a fitted map: around each curve where that
    coordinate of the map is with this probability, input by input:
    $y_a \pm z \sqrt{(U C U^\top)_{aa}}$ with covariance C and frame U of its `posterior`
    (by default `model.posterior()`) and z the quantile of a normal variable.

    **Raises** ValueError for other than one or two inputs, and for a `level` not between
    0 and 1 or with two."""
    with matplotlib().rc_context(STYLE):
        x, y = np.asarray(x), np.asarray(y)
        if x.ndim == 2 and x.shape[1] > 2 or x.ndim > 2:
            raise ValueError(
                f"Pictures need one or two inputs, `x` has shape {x.shape}."
            )
        shape, data = y.shape[1:] or (1,), y.reshape(len(y), -1)
        across = shape[-1] if len(shape) == 2 else min(3, data.shape[1])
        down = -(-data.shape[1] // across)
        draw = _curves if x.size == len(x) else _maps
        if level is not None and (draw is _maps or not 0 < level < 1):
            raise ValueError(
                "level: of bands around curves of one input, between 0 and 1; found "
                f"{level} and `x` of shape {x.shape}."
            )
        picture = figure(0.5 + 2.1 * across, 0.5 + 1.5 * down)
        panels = picture.subplots(
            down, across, squeeze=False, sharex=True, sharey=draw is _maps
        )
        draw(panels.flat, model, x, data)
        if level is not None:
            _bands(panels.flat, posterior or model.posterior(), x, level)
        labels = (label,) if isinstance(label, str) else label
        for c, panel in enumerate(panels.flat):
            if c >= data.shape[1]:
                panel.set_axis_off()
                continue
            indices = ",".join(str(1 + int(i)) for i in np.unravel_index(c, shape))
            name = names[c] if names else f"$y_{{{indices}}}$"
            if draw is _curves:
                panel.set_ylabel(name)
            else:
                panel.set(title=name, ylabel=labels[-1] if c % across == 0 else None)
        for panel in panels[-1]:
            panel.set_xlabel(labels[0])
        return picture


def _curves(panels: Any, model: Any, x: np.ndarray, data: np.ndarray) -> None:
    inputs = np.linspace(x.min(), x.max(), 500)
    curve = np.asarray(model(inputs.reshape(-1, *x.shape[1:]))).reshape(500, -1)
    for panel, fitted, observed in zip(panels, curve.T, data.T, strict=False):
        panel.plot(inputs, fitted, color=BLUE, lw=1.2)
        panel.plot(x.ravel(), observed, ".", color=ORANGE, ms=3.5, mew=0)


def _bands(panels: Any, posterior: Posterior, x: np.ndarray, level: float) -> None:
    inputs = np.linspace(x.min(), x.max(), BAND)
    at = inputs.reshape(-1, *x.shape[1:])
    curve = np.asarray(posterior.model(at)).reshape(BAND, -1)
    covariance, frames = posterior.covariance(at)
    variances = np.einsum("qtn,qnm,qtm->qt", frames, covariance, frames)
    z = quantile_radius(level, 1)
    radius = z * np.sqrt(np.maximum(variances, 0.0))
    for panel, middle, r in zip(panels, curve.T, radius.T, strict=False):
        ends = middle - r, middle + r
        panel.fill_between(inputs, *ends, color=BLUE, alpha=0.18, lw=0, zorder=1)


def _maps(panels: Any, model: Any, x: np.ndarray, data: np.ndarray) -> None:
    axes = [
        np.linspace(low, high, 60) for low, high in zip(x.min(0), x.max(0), strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes), axis=-1)
    values = np.asarray(model(grid.reshape(-1, 2))).reshape(3600, -1)
    for panel, fitted, observed in zip(panels, values.T, data.T, strict=False):
        low, high = min(fitted.min(), observed.min()), max(fitted.max(), observed.max())
        options = {"vmin": low, "vmax": high, "cmap": "cividis"}
        shade = {"shading": "gouraud", "rasterized": True}
        mesh = panel.pcolormesh(*axes, fitted.reshape(60, 60), **options, **shade)
        dots = {"s": 9, "edgecolors": "white", "linewidths": 0.4, "clip_on": False}
        panel.scatter(*x.T, c=observed, **options, **dots)
        figure_of(panel).colorbar(mesh, ax=panel, aspect=25).outline.set_linewidth(0.4)
