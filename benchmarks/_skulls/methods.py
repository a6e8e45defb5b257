"""Each sends the source's vertices and all its landmarks to the target."""

from typing import NamedTuple

import numpy as np
import trimesh
from _peers import clean_mesh, coherent_drift, landmark_warp, meshmonk_pyramid

import manireg as mr

from .precision import rigid_motion
from .tasks import Skull

DRIFT_POINTS = 1500  # a step takes half a second and grows with their cube


class Image(NamedTuple):
    vertices: np.ndarray
    """Of the clean mesh of the source."""
    landmarks: np.ndarray
    lam: float | None = None


def closest(task: Skull) -> Image:
    warp, onto = landmark_warp(*task.seen), task.target.cloud
    vertices = np.asarray(task.source.cloud.points)
    images = (onto.project(warp(x)) for x in (vertices, task.source_landmarks))
    return Image(*map(np.asarray, images))


def meshmonk(task: Skull, start: str) -> Image:
    """Landmarks are carried by the triangle that they are nearest to. They are not put
    onto the target: that made them worse."""
    mesh = clean_mesh(task.source)
    first = {"warp": landmark_warp, "rigid": rigid_motion}[start](*task.seen)
    begun = first(np.asarray(mesh.vertices))
    found = meshmonk_pyramid(begun, mesh.faces, clean_mesh(task.target))
    return Image(found, carried(mesh, task.source_landmarks, found))


def drift(task: Skull) -> Image:
    """From the warp of the landmarks, onto the target by closest points. Stiffness (alpha
    2), width (beta 2) and steps (100) are pycpd's defaults. On two skulls narrower kernels
    were up to twice as bad; stiffer ones come to no more than the warp."""
    warp, onto = landmark_warp(*task.seen), task.target.cloud
    sampled = [
        np.array(trimesh.sample.sample_surface(clean_mesh(s), DRIFT_POINTS, seed=0)[0])
        for s in (task.source, task.target)
    ]
    field = coherent_drift(warp(sampled[0]), sampled[1])
    vertices = np.asarray(task.source.cloud.points)
    images = (onto.project(field(warp(x))) for x in (vertices, task.source_landmarks))
    return Image(*map(np.asarray, images))


def carried(
    mesh: trimesh.Trimesh, points: np.ndarray, vertices: np.ndarray
) -> np.ndarray:
    """Points near a mesh, when its vertices are moved."""
    closest, _, triangle = trimesh.proximity.closest_point(mesh, points)
    shares = trimesh.triangles.points_to_barycentric(mesh.triangles[triangle], closest)
    return np.einsum("lk,lki->li", shares, vertices[mesh.faces[triangle]])


def registered(task: Skull, **options) -> Image:
    source, target = task.source, task.target
    found = mr.register(source, target, *task.seen, progress=False, **options)
    of_point = np.unique(source.of_vertex, return_index=True)[1]
    places = source.cloud.project(task.source_landmarks)
    return Image(
        found.vertices[of_point],
        np.asarray(found.model(places)),
        float(found.model.lam),
    )


METHODS = {
    "rbf_r": closest,
    "meshmonk_rigid": lambda task: meshmonk(task, "rigid"),
    "meshmonk_warp": lambda task: meshmonk(task, "warp"),
    "drift": drift,
    "landmarks": registered,
    "surface": lambda task: registered(task, surface=True),
}
