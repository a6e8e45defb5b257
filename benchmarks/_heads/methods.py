"""The methods: each sends the source's vertices to the target; most from
landmarks alone, the last of ours, MeshMonk and nricp from the whole target."""

import numpy as np
import trimesh
from _peers import clean_mesh, landmark_warp, meshmonk_pyramid
from _rkhs_warp import rkhs_warp

import manireg as mr
from manireg.datasets import HeadPair as Task


def register(task: Task, geometry: str, **options) -> tuple[np.ndarray, float]:
    """Positions and lambda, which leave-one-out over the landmarks chose."""
    found = mr.register(
        task.source,
        task.target,
        task.source_landmarks,
        task.target_landmarks,
        geometry=geometry,
        **options,
    )
    return found.vertices, float(found.model.lam)


def free_solution(task: Task) -> tuple[np.ndarray, float]:
    """The paper's thin plate: the same basis, energy and choice of lambda, but space as
    the target; then the closest point."""
    source = mr.Ambient(mr.PointCloud.from_mesh(task.source))
    x = np.asarray(task.source.vertices)
    problem = mr.make_problem(
        source,
        mr.Euclidean(3),
        x[task.source_landmarks],
        task.target_landmarks,
        centres=400,
        graded=True,
    )
    cv = mr.leave_one_out(problem)
    return np.asarray(_cloud(task).project(cv.model(x))), float(cv.lam)


def affine(task: Task) -> np.ndarray:
    """The least-squares affine map, then the closest point."""
    return np.asarray(_cloud(task).project(_affine_image(task)))


def _affine_image(task: Task) -> np.ndarray:
    x = np.asarray(task.source.vertices)
    ones = np.column_stack([x, np.ones(len(x))])
    at_landmarks = ones[task.source_landmarks]
    return ones @ np.linalg.lstsq(at_landmarks, task.target_landmarks, rcond=None)[0]


def volume_spline(task: Task, kernel: str) -> np.ndarray:
    x = np.asarray(task.source.vertices)
    warp = mr.baselines.volume_spline(
        x, x[task.source_landmarks], task.target_landmarks, _cloud(task), kernel=kernel
    )
    return warp.vertices


def warp(task: Task) -> np.ndarray:
    x = np.asarray(task.source.vertices)
    normals = np.asarray(task.source.vertex_normals)
    found = rkhs_warp(
        x, normals, x[task.source_landmarks], task.target_landmarks, _cloud(task)
    )
    return found.vertices


def nricp(task: Task, variant: str) -> np.ndarray:
    """Non-rigid iterative closest points as trimesh has them, with default steps, started
    from the affine map of the landmarks."""
    source = task.source.copy()
    source.vertices = _affine_image(task)
    source.update_faces(source.nondegenerate_faces())  # it inverts a matrix for each
    run = getattr(trimesh.registration, f"nricp_{variant}")
    moved = run(
        source,
        task.target,
        source_landmarks=task.source_landmarks,
        target_positions=task.target_landmarks,
    )
    return np.asarray(moved)


def meshmonk(task: Task) -> np.ndarray:
    """From the warp of the landmarks, with doubled vertices as one: it would do so itself
    and forget which they were."""
    source = mr.load_surface(task.source)
    mesh = clean_mesh(source)
    warp = landmark_warp(
        np.asarray(task.source.vertices)[task.source_landmarks], task.target_landmarks
    )
    found = meshmonk_pyramid(warp(mesh.vertices), mesh.faces, task.target)
    return found[source.of_vertex]


def _cloud(task: Task) -> mr.PointCloud:
    return mr.PointCloud.from_mesh(task.target)


METHODS = {
    "affine": affine,
    "rbf_r2logr": lambda task: volume_spline(task, "thin_plate_spline"),
    "rbf_r": lambda task: volume_spline(task, "linear"),
    "free_solution": free_solution,
    "rkhs_warp": warp,
    "manireg_tension": lambda task: register(task, "ambient"),
    "manireg_ambient": lambda task: register(task, "ambient", tension=0.0),
    "manireg_intrinsic": lambda task: register(task, "intrinsic"),
    "manireg_surface": lambda task: register(task, "ambient", surface=True),
    "meshmonk": meshmonk,
    "nricp_sumner": lambda task: nricp(task, "sumner"),
    "nricp_amberg": lambda task: nricp(task, "amberg"),
}
