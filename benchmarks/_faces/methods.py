"""Each sends the source's vertices to the target."""

import numpy as np
import trimesh
from scipy.interpolate import RBFInterpolator

import manireg as mr

from .tasks import Face


def warped(task: Face) -> np.ndarray:
    """By the biharmonic spline of space through the landmarks: the strong baseline."""
    x = np.asarray(task.source.vertices)
    spline = RBFInterpolator(
        x[task.source_landmarks], task.target_landmarks, kernel="linear", degree=1
    )
    return spline(x)


def closest(task: Face) -> np.ndarray:
    return np.asarray(mr.PointCloud.from_mesh(task.target).project(warped(task)))


def meshmonk(task: Face) -> np.ndarray:
    """Its pyramid with default settings, from the warp of the landmarks: the best of its
    starts, and better here than its single layer."""
    import meshmonk as mm

    mm.set_log_level("silent")
    start = trimesh.Trimesh(warped(task), task.source.faces, process=False)
    found = mm.pyramid_register(floating=start, target=task.target)
    return np.asarray(found.aligned_vertices, float)


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
