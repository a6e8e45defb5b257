"""Confidence regions on a manifold: ellipses of tangent spaces, sent to N by exp."""

import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.stats import chi2

from .._algebra.small import solve_symmetric
from .._input.numbers import Numbers
from .._programs.sizes import at_each
from .._sources.checks import check_points
from ..manifolds._defaults.frames import coordinates


class Region(eqx.Module):
    r"""At each of q points: $\{\exp_y(U z) : z^\top C^{-1} z \le r^2\}$, y the centre, U
    an orthonormal frame of $T_yN$."""

    target: Any
    centre: Float[Array, "q ..."]
    """On N, `(q, *point_shape)`."""
    covariance: Float[np.ndarray, "q n n"]
    frame: Float[np.ndarray, "q t n"]
    """U, in flattened ambient coordinates."""
    radius: float
    """r: the root of a quantile of chi-squared with n degrees of freedom, or of a band."""
    level: float
    """Of confidence, such as 0.95."""

    @property
    def semi_axes(self) -> Float[np.ndarray, "q n"]:
        """Lengths, ascending."""
        return self.radius * np.sqrt(np.maximum(self._principal[0], 0.0))

    @property
    def directions(self) -> Float[np.ndarray, "q t n"]:
        """Unit vectors along them, in flattened ambient coordinates."""
        return np.einsum("qta,qan->qtn", self.frame, self._principal[1])

    @property
    def theta95(self) -> Float[np.ndarray, " q"]:
        """Of the circle as large as the region, in degrees, on S^2: of a path the
        uncertainty of the path, not the scatter of the poles."""
        return np.degrees(np.sqrt(np.prod(self.semi_axes, axis=1)))

    @property
    def azimuth(self) -> Float[np.ndarray, " q"]:
        """Of the longest axis on S^2, in degrees from north, clockwise, in [0, 180)."""
        centre = np.asarray(self.centre).reshape(len(self.frame), -1)
        if centre.shape[1] != 3 or self.frame.shape[2] != 2:
            raise ValueError("azimuth: only of regions on the sphere S^2.")
        x, y, z = centre.T
        flat = np.hypot(x, y)
        east = np.stack([-y, x, np.zeros_like(x)], axis=1) / flat[:, None]
        north = np.cross(centre, east)
        longest = self.directions[:, :, -1]
        along = [np.sum(longest * v, axis=1) for v in (east, north)]
        return np.degrees(np.arctan2(*along)) % 180

    def contains(self, points: Numbers) -> np.ndarray:
        """Whether each of q points, `(q, *point_shape)`, lies in the region of its
        place."""
        flat = check_points("points", self.target, points, count=len(self.frame))
        owner = self.target
        arrays = np.asarray(self.centre), flat, self.frame, self.covariance
        lengths = at_each(_mahalanobis, owner, *arrays)
        return lengths <= self.radius**2

    def outline(self, m: int = 73) -> Float[np.ndarray, "q m ..."]:
        """Points along the rim, the first again last; of two-dimensional regions."""
        if self.frame.shape[2] != 2:
            raise ValueError(
                f"outline: a region of dimension {self.frame.shape[2]} has no rim to "
                "draw; use `semi_axes` and `directions`."
            )
        angle = np.linspace(0, 2 * np.pi, m)
        circle = np.stack([np.cos(angle), np.sin(angle)])
        ring = np.einsum("qtn,qn,nm->qmt", self.directions, self.semi_axes, circle)
        centre = np.repeat(np.asarray(self.centre), m, axis=0)
        points = at_each(_sent, self.target, centre, ring.reshape(len(centre), -1))
        return points.reshape(len(ring), m, *self.target.point_shape)

    @property
    def _principal(self):
        return np.linalg.eigh(self.covariance)


def quantile_radius(level: float, n: int) -> float:
    if not 0 < level < 1:
        raise ValueError(f"level: must lie between 0 and 1, found {level}.")
    return math.sqrt(chi2.ppf(level, n))


def conformal_radius(
    level: float, lengths: Float[np.ndarray, " k"], otherwise: float
) -> float:
    """The least radius that holds a share `level` of k data and one more."""
    rank = math.ceil((len(lengths) + 1) * level)
    return float(np.sort(lengths)[rank - 1]) if rank <= len(lengths) else otherwise


def _mahalanobis(target, centre, point, frame, covariance):
    log = target.log(centre, point.reshape(target.point_shape)).ravel()
    z = coordinates(target, centre, frame, log)
    return jnp.sum(z * solve_symmetric(covariance, z))


def _sent(target, centre, v):
    return target.exp(centre, v.reshape(target.point_shape))
