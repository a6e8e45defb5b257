"""Runs of one method, a line each in a table that grows."""

import time
from argparse import Namespace
from pathlib import Path

import numpy as np
import trimesh
from _table_file import append_row, read_rows

FIELDS = ("landmarks", "method", "target", "error", "p95", "folds", "seconds")
Key = tuple[int, str, int]


def read_runs(out: Path) -> dict[Key, dict[str, str]]:
    return {
        (int(r["landmarks"]), r["method"], int(r["target"])): r
        for r in read_rows(out / "faces.csv")
    }


def run(options: Namespace) -> None:
    """The worker: one method, target after target."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from .methods import METHODS
    from .tasks import face, vertex_areas

    (landmarks,), (method,) = options.landmarks, options.methods
    METHODS[method](face(options.targets[0], landmarks))  # compiles
    for target in options.targets:
        task = face(target, landmarks)
        start = time.perf_counter()
        vertices = METHODS[method](task)
        seconds = time.perf_counter() - start
        errors = np.linalg.norm(vertices - task.truth, axis=1)
        area = vertex_areas(task.source)
        row = {"landmarks": landmarks, "method": method, "target": target}
        row |= {"error": f"{np.sum(area * errors) / np.sum(area):.4f}"}
        row |= {"p95": f"{np.percentile(errors, 95):.4f}"}
        row |= {"folds": f"{folded(vertices, task):.5f}", "seconds": f"{seconds:.1f}"}
        append_row(options.out / "faces.csv", FIELDS, row)


def folded(vertices: np.ndarray, task) -> float:
    """Share of the triangles that are turned away from the true ones."""
    normals = [
        trimesh.Trimesh(v, task.source.faces, process=False).face_normals
        for v in (vertices, task.truth)
    ]
    return float(np.mean(np.sum(normals[0] * normals[1], axis=1) <= 0))
