"""The flight, its noisy data, and what a method makes of them."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from manireg.datasets import data_folder

DEGREES, METRES = 1.0, 0.02  # standard deviations about and along each axis
EVERY = 5  # of the poses at 50 Hz


class Truth(NamedTuple):
    times: np.ndarray
    """Seconds since the first."""
    rotations: Rotation
    positions: np.ndarray
    twists: np.ndarray
    """`(k, 6)`: angular velocity in axes of the body, by differences; the file's linear
    velocity, in axes of space."""


class Noisy(NamedTuple):
    times: np.ndarray
    rotations: Rotation
    positions: np.ndarray
    sigma: np.ndarray
    """Radians about each axis, metres along each."""


class Found(NamedTuple):
    """At k times."""

    rotations: Rotation
    positions: np.ndarray
    twists: np.ndarray
    """Angular velocity in axes of the body, linear in axes of space."""
    pose_covariances: np.ndarray | None = None
    """Rotation vectors in axes of the body, and positions."""
    twist_covariances: np.ndarray | None = None
    body: bool = False
    """Whether the covariances of positions and linear velocities are along axes of the
    body, too."""


def truth(seconds: float = np.inf) -> Truth:
    """The flight, or its beginning."""
    path = data_folder() / "tables" / "se3_euroc_v102.csv"
    names = path.read_text().splitlines()[1].split(",")
    table = np.loadtxt(path, delimiter=",", skiprows=2)
    stamps = np.loadtxt(path, delimiter=",", skiprows=2, usecols=1, dtype=np.int64)
    columns = lambda text: table[:, [names.index(name) for name in text.split()]]
    times = (stamps - stamps[0]) * 1e-9
    rotations = Rotation.from_quat(columns("qw qx qy qz"), scalar_first=True)
    turns = (rotations[:-1].inv() * rotations[1:]).as_rotvec() / np.diff(times)[:, None]
    turns = np.concatenate([turns[:1], (turns[1:] + turns[:-1]) / 2, turns[-1:]])
    twists = np.concatenate([turns, columns("vx vy vz")], axis=1)
    n = int(np.sum(times <= seconds))
    return Truth(times[:n], rotations[:n], columns("px py pz")[:n], twists[:n])


def noisy(flight: Truth, seed: int) -> Noisy:
    kept = np.arange(0, len(flight.times), EVERY)
    rng = np.random.default_rng(seed)
    turns = np.radians(DEGREES) * rng.normal(size=(len(kept), 3))
    rotations = flight.rotations[kept] * Rotation.from_rotvec(turns)
    positions = flight.positions[kept] + METRES * rng.normal(size=(len(kept), 3))
    sigma = np.array([np.radians(DEGREES), METRES])
    return Noisy(flight.times[kept], rotations, positions, sigma)
