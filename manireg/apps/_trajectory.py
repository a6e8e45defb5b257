"""Poses of a body over time, smoothed: where it was, how it turned, how fast, how sure."""

import warnings
from typing import Any, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from .._input.numbers import Numbers, as_numbers
from .._objective.resolution import ResolutionWarning
from .._objective.robust import AbstractLoss
from .._selection.criteria import CriterionName
from .._selection.fit import fit
from .._solver.posterior import Posterior
from .._sources.sources import Interval
from ..manifolds import Euclidean, Sphere
from ..manifolds._matrices.poses import rotations_of
from ..manifolds._matrices.turns import quaternion_turn_rate
from ._outliers import outliers
from ._signs import lifted
from ._stamps import first_of, seconds_since

QUATERNIONS = Sphere(3, 2.0)  # unit ones times 2: distances are angles of rotation
ORDERS = (2, 3)
LEAST, MOST = 32, 2000  # centres
DATA_A_CENTRE = 4.0
LOST = 1 / 3  # of a datum's weight: with less it counts as an outlier
CRITERIA = {"position": "error", "orientation": "reml"}
LONG = 3.0  # median steps between data, from where on it is a gap


class Motion(NamedTuple):
    """Of a body at q times, with covariances (None where it was not known)."""

    positions: Float[np.ndarray, "q 3"] | None
    quaternions: Float[np.ndarray, "q 4"] | None
    """w, x, y, z, each with the sign that continues the one before."""
    velocities: Float[np.ndarray, "q 3"] | None
    """In axes of space, per second."""
    angular_velocities: Float[np.ndarray, "q 3"] | None
    """In axes of the body, radians per second."""
    position_covariances: Float[np.ndarray, "q 3 3"] | None
    orientation_covariances: Float[np.ndarray, "q 3 3"] | None
    """Of rotation vectors in axes of the body: $R \\exp[\\rho]_\\times$, radians."""
    velocity_covariances: Float[np.ndarray, "q 3 3"] | None
    angular_velocity_covariances: Float[np.ndarray, "q 3 3"] | None


class Gap(NamedTuple):
    """A time without data, seconds since the first."""

    start: float
    end: float
    bridged: bool
    """Whether it is shorter than what the smoother averages over anyway."""


class Part(NamedTuple):
    """The positions, or the orientations."""

    posterior: Posterior
    origin: Any
    """Added to its values."""
    sigma: float
    """Standard deviation of a datum about or along each axis, as taken."""
    order: int
    """Of the energy."""
    window: float
    """Seconds that the smoother averages over: the time of the data, over their effective
    degrees of freedom along each axis."""
    outliers: np.ndarray
    """Indices of the data that were left out, or that the loss has let go of."""


class Trajectory(NamedTuple):
    """Poses as a smooth function of time. Made by `trajectory`."""

    first: Any
    """The first time, exactly; times count from there."""
    unit: float
    """Seconds."""
    times: Float[np.ndarray, " k"]
    """Of the data, seconds since the first."""
    position: Part | None
    orientation: Part | None

    def at(self, times: Numbers) -> Motion:
        """The pose and how it moves at q times, written like those of the data."""
        return self.after(seconds_since(times, self.first, self.unit))

    def after(self, t: Float[np.ndarray, " q"]) -> Motion:
        """The same, at seconds since the first.

        **Raises** ValueError outside the time of the data."""
        found = dict.fromkeys(Motion._fields)
        if self.position is not None:
            posterior = self.position.posterior
            found["positions"] = np.asarray(posterior.model(t)) + self.position.origin
            found["position_covariances"] = _in_space(*posterior.covariance(t))
            v = posterior.velocity(t)
            found["velocities"] = np.asarray(v.value)
            found["velocity_covariances"] = _in_space(v.covariance, v.frame)
        if self.orientation is not None:
            posterior = self.orientation.posterior
            q, (c, frames) = np.asarray(posterior.model(t)), posterior.covariance(t)
            found["quaternions"] = q / np.linalg.norm(q, axis=1, keepdims=True)
            rates = _turn(jnp.asarray(q[:, None]), jnp.swapaxes(frames, 1, 2))
            along = np.swapaxes(np.asarray(rates), 1, 2)
            found["orientation_covariances"] = _in_space(c, along)
            w = posterior.reading(t, _turn)
            found["angular_velocities"] = np.asarray(w.value)
            found["angular_velocity_covariances"] = w.covariance
        return Motion(**found)

    @property
    def parts(self) -> dict[str, Part]:
        both = {"position": self.position, "orientation": self.orientation}
        return {name: part for name, part in both.items() if part is not None}

    @property
    def outliers(self) -> np.ndarray:
        """Indices of data of which position or orientation is an outlier."""
        each = [part.outliers for part in self.parts.values()]
        return np.unique(np.concatenate(each))

    @property
    def gaps(self) -> list[Gap]:
        """Steps between data that are longer than three of the median."""
        window = min(part.window for part in self.parts.values())
        t = np.unique(np.delete(self.times, self.outliers))
        steps = np.diff(t)
        long = np.flatnonzero(steps > LONG * np.median(steps))
        return [Gap(t[i], t[i + 1], bool(steps[i] <= window)) for i in long.tolist()]


def trajectory(
    times: Numbers,
    positions: Numbers | None = None,
    orientations: Numbers | None = None,
    *,
    quaternions: Literal["wxyz", "xyzw"] | None = None,
    unit: float = 1.0,
    position_sigma: float | None = None,
    orientation_sigma: float | None = None,
    loss: AbstractLoss | str = "squared",
    reject: bool = True,
    order: Any = ORDERS,
    criterion: CriterionName | None = None,
    centres: int | None = None,
    **options,
) -> Trajectory:
    r"""Smooth poses of a body: positions, orientations or both, as functions of time.

    Both are fitted by themselves, each with its own noise, smoothness and order. That is
    `mr.fit` into `SpecialEuclidean(3, length)` where noise of positions and of
    orientations is independent: loss and energy are sums, and the length no more than the
    ratio of two lambdas, which the data choose here. For noise that is correlated see
    `SpecialEuclidean.noise_of`. Orientations are unit quaternions, lifted to one of the
    two signs along the curve.

    **Arguments:**

    - `times`: `(k,)`, in any order: numbers of a `unit` of so many seconds, or dates.
      Integers, such as nanoseconds since 1970 (`unit=1e-9`), are taken exactly.
    - `positions`: `(k, 3)`; `orientations`: scipy's `Rotation` or unit quaternions
      `(k, 4)` from the body to space, with `quaternions` saying where the scalar is.
    - `position_sigma`, `orientation_sigma`: standard deviations of the noise along each
      axis, and about each in radians; by default found with the fit.
    - `reject`: leave out data that are far from the cubic through their four neighbours
      in time, as measured by how far others nearby are (about nine standard deviations).
    - `loss`: as in `mr.fit`. Of a robust one data that are left less than a third of their
      weight are called outliers, too. (Such losses may take a manoeuvre that is quicker
      than the rest for outliers.)
    - `order`: of the energy, or several (default 2 and 3), of which positions and
      orientations each take the one that their criterion is lower for.
    - `centres`: default a quarter as many as data, and where a `ResolutionWarning` says
      that these are too few, as many; within 32 and 2,000.
    - `criterion`: what smoothness and order are chosen by, as in `mr.fit`; default the
      `"error"` of data left out for positions, `"reml"`, the restricted likelihood, for
      orientations. Other options: as in `mr.fit`.

    **Returns** a `Trajectory`: `.at(times)` has poses, velocities, and how sure they are;
    `.outliers`, `.gaps`.

    **Raises** ValueError as `mr.fit` does.

    **Example:**

        found = mr.apps.trajectory(stamps, xyz, q, quaternions="xyzw", unit=1e-9)
        motion = found.at(stamps)
        np.degrees(motion.angular_velocities)
    """
    first = first_of(times)
    t = seconds_since(times, first, unit)
    common = {"loss": loss, "order": order, "centres": centres, "reject": reject}
    common |= options
    if positions is None and orientations is None:
        raise ValueError("trajectory: give positions, orientations or both.")
    position = orientation = None
    if positions is not None:
        p = as_numbers("positions", positions)
        how: Any = common | {"criterion": criterion or CRITERIA["position"]}
        position = _part(
            Euclidean(3), t, p, position_sigma, origin=p.mean(axis=0), **how
        )
    if orientations is not None:
        if quaternions is None and not hasattr(orientations, "as_quat"):
            raise ValueError(
                'trajectory: say `quaternions="wxyz"` or "xyzw", where the scalar is.'
            )
        rotation = rotations_of(orientations, quaternions or "wxyz")
        q = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
        points = QUATERNIONS.radius * lifted(t, q)
        how: Any = common | {"criterion": criterion or CRITERIA["orientation"]}
        orientation = _part(QUATERNIONS, t, points, orientation_sigma, **how)
    return Trajectory(first, unit, t, position, orientation)


def _part(target, t, y, sigma, reject, origin: Any = 0.0, **options) -> Part:
    noise = {} if sigma is None else {"sigma": float(sigma), "scatter": "none"}
    y = y - origin
    kept = np.flatnonzero(~outliers(t, y)) if reject else np.arange(len(t))
    data = Interval(t.min(), t.max()), target, t[kept], y[kept]
    model = _resolved(*data, **noise, **options)
    posterior = model.posterior()
    summary = posterior.summary()
    found = summary.sigma_given or summary.sigma
    window = float(np.ptp(t)) * target.dim / summary.edf
    gone = np.setdiff1d(np.arange(len(t)), kept)
    lost = np.union1d(gone, kept[model.data_weights < LOST])
    return Part(posterior, origin, found, summary.order, window, lost)


def _resolved(source, target, t, y, centres, **options):
    """With centres enough for the data, where they are not given."""
    most = min(MOST, len(np.unique(t)))
    asked = (
        int(np.clip(most / DATA_A_CENTRE, LEAST, MOST)) if centres is None else centres
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model = fit(source, target, t, y, centres=asked, progress=False, **options)
    coarse = [w for w in caught if issubclass(w.category, ResolutionWarning)]
    if coarse and centres is None and asked < most:
        return _resolved(source, target, t, y, most, **options)
    for w in caught:
        warnings.warn(w.message, w.category, stacklevel=5)
    return model


def _in_space(covariance, frame) -> np.ndarray:
    return frame @ covariance @ np.swapaxes(frame, 1, 2)


def _turn(q, v):
    return quaternion_turn_rate(q, v, "body")
