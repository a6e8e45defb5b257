"""The picture of `manireg fit`."""

from pathlib import Path
from typing import Any

import numpy as np

import manireg as mr

from .. import plot
from .._solver.regions import quantile_radius
from .axes import Axis
from .tables import Target, TargetName
from .uncertainty import uncertainty


def draw(
    path: Path,
    model: Any,
    posterior: Any,
    x: np.ndarray,
    there: Target,
    axes: list[Axis],
    level: float,
) -> None:
    """Data, fit and, of one input, where the fit is with `level` percent."""
    y, one = there.points, x.ndim == 1
    names = there.columns if y[0].size == len(there.columns) else None
    labels = tuple(axis.label for axis in axes)
    share = level / 100 if one and np.isfinite(posterior.scale) else None
    if one and isinstance(there.manifold, mr.Sphere) and there.manifold.dim == 2:
        picture = plot.sphere_path(
            model, x, y, label=labels[0], level=share, posterior=posterior
        )
    elif one and len(there.columns) < y[0].size == 2:
        picture = _angles(model, posterior, x, there, labels[0], share)
    else:
        picture = plot.coordinates(
            model, x, y, names=names, label=labels, level=share, posterior=posterior
        )
    plot.save(picture, path)


def _angles(model, posterior, x, there: Target, label: str, share: float | None):
    """Of a circle, in degrees that do not jump."""

    def angle(t):
        return np.unwrap(there.decode(np.asarray(model(t)))[:, 0], period=360)

    inputs = np.linspace(x.min(), x.max(), 500)
    fitted = angle(inputs)
    near = np.interp(x, inputs, fitted)
    data = near + (there.decode(there.points)[:, 0] - near + 180) % 360 - 180
    name = f"{there.columns[0]} (degrees)"
    picture = plot.coordinates(angle, x, data, names=(name,), label=label)
    if share is not None:
        error = uncertainty(posterior, TargetName.circle, there, inputs, 100 * share)
        half = quantile_radius(share, 1) * error[1][:, 0]
        panel = picture.axes[0]
        panel.fill_between(inputs, fitted - half, fitted + half, alpha=0.25, lw=0)
    return picture
