"""Six mouse skulls (micro-CT, SlicerMorph's Mouse_Models) with 51 hand-set landmarks."""

from typing import NamedTuple

import numpy as np

import manireg as mr
from manireg.datasets import data_folder

SOURCE = "A_J"
TARGETS = ("C57BL6_J", "CAST_EIJ", "DBA_2J", "NZO", "WSB")
FITTED = {36: lambda i: i % 10 < 7, 13: lambda i: i % 4 == 0}


class Skull(NamedTuple):
    source: mr.Surface
    target: mr.Surface
    source_landmarks: np.ndarray
    """As they were set: up to 0.16 mm off the surface."""
    target_landmarks: np.ndarray
    fitted: np.ndarray
    """Which of the landmarks the methods see."""

    @property
    def seen(self) -> tuple[np.ndarray, np.ndarray]:
        return self.source_landmarks[self.fitted], self.target_landmarks[self.fitted]


def skull(target: str, landmarks: int) -> Skull:
    surfaces = [mr.load_surface(_file(name, "ply")) for name in (SOURCE, target)]
    places = [landmarks_of(name) for name in (SOURCE, target)]
    return Skull(*surfaces, *places, fitted(landmarks))


def fitted(landmarks: int) -> np.ndarray:
    return FITTED[landmarks](np.arange(51))


def landmarks_of(name: str) -> np.ndarray:
    positions = mr.read_landmarks(_file(name, "mrk.json")).positions
    assert positions is not None
    return positions


def _file(name: str, suffix: str):
    return data_folder() / "meshes" / f"skull_{name}.{suffix}"
