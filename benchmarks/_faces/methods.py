"""Each sends the source's vertices to the target."""

import numpy as np
from _peers import landmark_warp, meshmonk_pyramid

import manireg as mr

from .tasks import Face


def warped(task: Face) -> np.ndarray:
    x = np.asarray(task.source.vertices)
    return landmark_warp(x[task.source_landmarks], task.target_landmarks)(x)


def closest(task: Face) -> np.ndarray:
    return np.asarray(mr.PointCloud.from_mesh(task.target).project(warped(task)))


def meshmonk(task: Face) -> np.ndarray:
    """From the warp of the landmarks: the best of its starts, and better here than its
    single layer."""
    return meshmonk_pyramid(warped(task), task.source.faces, task.target)


def registered(task: Face, **options) -> np.ndarray:
    pairs = task.source_landmarks, task.target_landmarks
    found = mr.register(task.source, task.target, *pairs, progress=False, **options)
    return found.vertices


METHODS = {
    "rbf_r": closest,
    "meshmonk": meshmonk,
    "landmarks": registered,
    "surface": lambda task: registered(task, surface=True),
}
