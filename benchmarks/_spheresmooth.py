"""The peer for paths on the sphere: the penalised piecewise geodesics of spheresmooth (Bak
et al. 2023; GPL, extra `paths`), its smoothing and its number of knots by its own BIC."""

from functools import partial
from typing import NamedTuple
from unittest import mock

import numpy as np

# as in the package's example of a polar wander path
LAMS = np.exp(np.linspace(np.log(1e-7), 0.0, 40))
EXAMPLE = 15  # knots


class GeodesicSpline(NamedTuple):
    """Geodesics between control points at knots; before the first age and after the last,
    where the package has no value, the first or last point."""

    points: np.ndarray
    knots: np.ndarray
    first: float
    last: float
    bic: float

    def __call__(self, x) -> np.ndarray:
        inside = np.clip(x, self.first, self.last) - self.first
        times = inside / (self.last - self.first)
        return piecewise_geodesic(times, self.points, self.knots)


def geodesic_spline(x: np.ndarray, y: np.ndarray, counts) -> GeodesicSpline:
    """That of the least BIC of all lambdas and starting numbers of knots (the penalty
    removes some). Times are scaled to the unit interval, as the package's data are."""
    order = np.argsort(x, kind="stable")
    first, last = x[order[0]], x[order[-1]]
    fit = partial(_of_least_bic, (x[order] - first) / (last - first), y[order])
    points, knots, bic = min((fit(count) for count in counts), key=lambda f: f[2])
    return GeodesicSpline(points, knots, first, last, bic)


def _of_least_bic(times, y, count: int):
    import spheresmooth

    # the package's own is a loop over times, a hundred times as slow
    name = "spheresmooth.smoothing.piecewise_geodesic"
    with mock.patch(name, piecewise_geodesic):
        found = spheresmooth.penalized_linear_spherical_spline(
            t=times,
            y=y,
            dimension=count,
            initial_knots=spheresmooth.knots_quantile(times, count),
            lambdas=LAMS,
        )
    best = int(np.argmin(found["bic_list"]))
    fit = found["fits"][best]
    return fit["control_points"], fit["knots"], float(found["bic_list"][best])


def piecewise_geodesic(t, control_points, knots) -> np.ndarray:
    """The package's function of that name for times between the knots."""
    j = np.searchsorted(knots, t, side="right") - 1
    p, q = control_points[j], control_points[j + 1]
    cosine = np.clip(np.sum(p * q, axis=1), -1, 1)
    angle = (np.arccos(cosine) * (t - knots[j]) / (knots[j + 1] - knots[j]))[:, None]
    across = q - cosine[:, None] * p
    length = np.linalg.norm(across, axis=1, keepdims=True)
    unit = across / np.where(length > 0, length, 1.0)
    return np.cos(angle) * p + np.sin(angle) * unit
