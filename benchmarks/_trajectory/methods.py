"""What smooths the flight: `(data, times) -> Found`."""

import importlib.util

import numpy as np
from scipy.interpolate import CubicSpline, make_smoothing_spline
from scipy.spatial.transform import Rotation, RotationSpline

import manireg as mr

from .tracks import Found, Noisy


def manireg(data: Noisy, times: np.ndarray) -> Found:
    """As it comes, told how large the noise is, as GTSAM is."""
    found = mr.apps.trajectory(
        data.times,
        data.positions,
        data.rotations,
        orientation_sigma=float(data.sigma[0]),
        position_sigma=float(data.sigma[1]),
        loss="squared",
    )
    m = found.after(times)
    return Found(
        Rotation.from_quat(m.quaternions, scalar_first=True),
        m.positions,
        np.concatenate([m.angular_velocities, m.velocities], axis=1),
        _blocks(m.orientation_covariances, m.position_covariances),
        _blocks(m.angular_velocity_covariances, m.velocity_covariances),
    )


def interpolated(data: Noisy, times: np.ndarray) -> Found:
    """Through the noisy data: there is nothing to choose."""
    turn = RotationSpline(data.times, data.rotations)
    way = CubicSpline(data.times, data.positions)
    rotations = turn(times)
    # scipy's rates are about axes of space
    rates = rotations.inv().apply(turn(times, 1))
    return Found(rotations, way(times), np.concatenate([rates, way(times, 1)], axis=1))


def smoothed(data: Noisy, times: np.ndarray) -> Found:
    """Cubic smoothing splines by generalised cross-validation, of the positions and of the
    four numbers of the quaternions, made of length one."""
    q = data.rotations.as_quat(scalar_first=True)
    signs = np.where(np.sum(q[1:] * q[:-1], axis=1) < 0, -1.0, 1.0)
    q = q * np.cumprod(np.append(1.0, signs))[:, None]
    way, quaternion = (
        make_smoothing_spline(data.times, v) for v in (data.positions, q)
    )
    p, v = quaternion(times), quaternion.derivative()(times)
    w, a, s, b = p[:, :1], p[:, 1:], v[:, :1], v[:, 1:]
    rates = 2 * (w * b - s * a - np.cross(a, b)) / np.sum(p**2, axis=1, keepdims=True)
    twists = np.concatenate([rates, way.derivative()(times)], axis=1)
    return Found(Rotation.from_quat(p, scalar_first=True), way(times), twists)


def gtsam(data: Noisy, times: np.ndarray) -> Found:
    from .wnoa import wnoa

    return wnoa(data, times)


METHODS = {
    "manireg": manireg,
    "GTSAM, WNOA process": gtsam,
    "RotationSpline, CubicSpline": interpolated,
    "smoothing splines (GCV)": smoothed,
}
if importlib.util.find_spec("gtsam") is None:  # of the extra `trajectories`
    del METHODS["GTSAM, WNOA process"]


def _blocks(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    found = np.zeros((len(a), 6, 6))
    found[:, :3, :3], found[:, 3:, 3:] = a, b
    return found
