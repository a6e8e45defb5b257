"""Which data are odd, and whether the noise is what the fit takes it for."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ._figure import BLUE, GREY, ORANGE, STYLE, figure, matplotlib

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
else:
    Axes = Figure = Any

PANEL = np.array([130.0, 135.0])  # about its size, in points
FAR = 4.0  # of the largest quantile: beyond, the axes are logarithmic


def residuals(model: Any) -> Figure:
    r"""Three panels of a fitted map (`model.summary().each`), the worst five data labelled
    by their index:

    - the length of the residual of each datum in the fit without it, in units of
      $\hat\sigma$, against its input, or its index where inputs are not single numbers;
    - squared standardised residuals against quantiles of $\chi^2_n$, where Gaussian noise
      lies on the diagonal;
    - leverage, how much a datum pulls the map to itself, against the standardised
      residual: what is high in both decides the fit, and may be wrong.

    **Raises** ValueError as `model.summary()` does."""
    from scipy.stats import chi2

    summary = model.summary()
    each, worst = summary.each, np.argsort(-summary.each.standardised)[:5]
    single = each.inputs.ndim == 1 or each.inputs.size == len(each.inputs)
    at = each.inputs.ravel() if single else each.data
    order = np.argsort(each.standardised)
    share = (np.arange(len(order)) + 0.5) / len(order)
    expected = np.zeros(len(order))
    expected[order] = chi2.ppf(share, summary.n)
    squares = each.standardised**2
    with matplotlib().rc_context(STYLE):
        picture = figure(7.4, 2.5)
        along, quantiles, pull = picture.subplots(1, 3)
        lengths = each.left_out / summary.sigma
        _dots(along, at, lengths, worst)
        label = r"residual, left out ($\hat\sigma$)"
        along.set(xlabel="input" if single else "index", ylabel=label, ylim=(0, None))
        _dots(quantiles, expected, squares, worst)
        low, high = expected.min(), expected.max()
        quantiles.plot([low, high], [low, high], color=GREY, lw=0.8, zorder=1)
        quantiles.set(xlabel=rf"quantile of $\chi^2_{{{summary.n}}}$")
        quantiles.set(ylabel="squared standardised residual")
        if np.max(squares, initial=0, where=np.isfinite(squares)) > FAR * high:
            quantiles.set(xscale="log", yscale="log", xlim=(low / 1.5, 2 * high))
            quantiles.set_ylim(low / 3, None)
        else:
            quantiles.set(xlim=(0, None), ylim=(0, None))
        _dots(pull, each.standardised, each.leverages, worst)
        pull.set(xlabel="standardised residual", ylabel="leverage")
        pull.set(xlim=(0, None), ylim=(0, None))
        _labels(along, at, lengths, each.data, worst)
        _labels(quantiles, expected, squares, each.data, worst)
        _labels(pull, each.standardised, each.leverages, each.data, worst)
        return picture


def _dots(panel: Axes, x, y, worst) -> None:
    keep = np.isfinite(x) & np.isfinite(y)
    style = {"ms": 3.5, "mew": 0, "clip_on": False, "zorder": 3}
    panel.plot(x[keep], y[keep], ".", color=BLUE, alpha=0.7, **style)
    marked = worst[keep[worst]]
    panel.plot(x[marked], y[marked], ".", color=ORANGE, **style)
    panel.margins(0.08)


def _labels(panel: Axes, x, y, index, worst) -> None:
    """Each beside its dot, where no other label is: of panels that have their limits."""
    place = panel.transData + panel.transAxes.inverted()
    taken = []
    for i in worst[np.isfinite(x[worst]) & np.isfinite(y[worst])]:
        at, text = place.transform((x[i], y[i])) * PANEL, str(index[i])
        width = 4.0 * len(text)
        for right, up in ((1, 1), (0, 1), (1, 0), (0, 0), (1, 2), (0, 2)):
            corner = at + [2.0 if right else -2.0 - width, (-8.0, 1.0, 8.0)[up]]
            apart = [np.any(np.abs(corner - other) >= room) for other, room in taken]
            if all(apart):
                break
        taken.append((corner, (width + 1, 7.0)))
        offset = {"xytext": corner - at, "textcoords": "offset points", "fontsize": 6}
        panel.annotate(text, (x[i], y[i]), color=ORANGE, zorder=4, **offset)
