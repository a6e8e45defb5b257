"""SIMPOP (of MeshMonk, Apache-2.0): 15 faces of 7,160 vertices in dense correspondence."""

from typing import NamedTuple

import numpy as np
import trimesh

from manireg.datasets import data_folder

ITERATIONS, LENGTH = 8, 1.7  # mm, of the target's remeshing


class Face(NamedTuple):
    source: trimesh.Trimesh
    target: trimesh.Trimesh
    source_landmarks: np.ndarray
    """Vertices of the source."""
    target_landmarks: np.ndarray
    truth: np.ndarray
    """Where each vertex of the source belongs, for scoring only."""


def face(target: int, landmarks: int) -> Face:
    with np.load(data_folder() / "meshes" / "faces_simpop.npz") as arrays:
        vertices, triangles = arrays["vertices"].astype(float), arrays["faces"]
    triangles = triangles.astype(int)
    places = farthest(vertices[0], 20)[:landmarks]
    truth = vertices[target]
    return Face(
        trimesh.Trimesh(vertices[0], triangles, process=False),
        remeshed(truth, triangles, seed=target),
        places,
        truth[places],
        truth,
    )


def farthest(points: np.ndarray, count: int) -> np.ndarray:
    """From the tip of the nose, each the farthest from those before it."""
    chosen = [int(np.argmax(points[:, 2]))]
    distance = np.full(len(points), np.inf)
    while len(chosen) < count:
        to_last = np.linalg.norm(points - points[chosen[-1]], axis=1)
        distance = np.minimum(distance, to_last)
        chosen.append(int(np.argmax(distance)))
    return np.array(chosen)


def remeshed(vertices: np.ndarray, triangles: np.ndarray, seed: int) -> trimesh.Trimesh:
    """The same surface with other vertices, in random order."""
    try:
        import pymeshlab
    except ImportError as error:
        raise SystemExit("faces: pip install 'manireg[faces]' (pymeshlab)") from error
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(vertices, triangles))
    meshes.meshing_isotropic_explicit_remeshing(
        iterations=ITERATIONS, targetlen=pymeshlab.PureValue(LENGTH)
    )
    new = meshes.current_mesh()
    order = np.random.default_rng(seed).permutation(new.vertex_number())
    return trimesh.Trimesh(
        new.vertex_matrix()[order],
        np.argsort(order)[new.face_matrix()],
        process=False,
    )


def vertex_areas(mesh: trimesh.Trimesh) -> np.ndarray:
    shares = np.repeat(mesh.area_faces / 3, 3)
    return np.bincount(np.ravel(mesh.faces), shares, minlength=len(mesh.vertices))
