"""Other libraries' ways from one surface to another, shared by the benchmarks."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import trimesh
from scipy.interpolate import RBFInterpolator
from scipy.spatial.distance import cdist

import manireg as mr

BETA = 2.0  # pycpd's default width of its kernel
TOLERANCE = 1e-6  # of a variance of 1; its default, 1e-3, stops it at once


def clean_mesh(surface: mr.Surface) -> trimesh.Trimesh:
    """What every method is given: repaired, without the smallest components."""
    points, triangles = surface.cloud.points, surface.cloud.triangles
    return trimesh.Trimesh(np.asarray(points), np.asarray(triangles), process=False)


def landmark_warp(source: np.ndarray, target: np.ndarray) -> RBFInterpolator:
    """The biharmonic spline of space through the landmarks: the strong baseline."""
    return RBFInterpolator(source, target, kernel="linear", degree=1)


def meshmonk_pyramid(
    start: np.ndarray, faces: np.ndarray, target: trimesh.Trimesh
) -> np.ndarray:
    """MeshMonk (White et al. 2019) with default settings, from vertices where a first map
    sends them."""
    import meshmonk

    meshmonk.set_log_level("silent")
    floating = trimesh.Trimesh(start, faces, process=False)
    with _silent():
        found = meshmonk.pyramid_register(floating=floating, target=target)
    return np.asarray(found.aligned_vertices, float)


class CoherentDrift(NamedTuple):
    """The displacement field that coherent point drift (Myronenko and Song 2010) found:
    Gaussians at points of the source, in the unit that the points had there."""

    places: np.ndarray
    weights: np.ndarray
    centre: np.ndarray
    unit: float

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Where points are sent; in blocks, as a kernel of all would be gigabytes."""
        moved = []
        for block in np.array_split(x, 1 + len(x) // 5000):
            z = (block - self.centre) / self.unit
            kernel = np.exp(-cdist(z, self.places, "sqeuclidean") / (2 * BETA**2))
            moved.append(self.centre + self.unit * (z + kernel @ self.weights))
        return np.concatenate(moved)


def coherent_drift(source: np.ndarray, target: np.ndarray) -> CoherentDrift:
    """pycpd's deformable registration of points that a first map has sent near the
    target, in units of the target's standard deviation, as the method's paper has it."""
    from pycpd import DeformableRegistration

    centre, unit = target.mean(axis=0), float(np.sqrt(target.var(axis=0).mean()))
    places, aims = ((points - centre) / unit for points in (source, target))
    drift = DeformableRegistration(X=aims, Y=places, beta=BETA, tolerance=TOLERANCE)
    drift.register()
    return CoherentDrift(places, drift.W, centre, unit)


@contextmanager
def _silent() -> Iterator[None]:
    """OpenMesh names every edge that it cannot add on the error stream of the process:
    thousands on scans."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
            yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
