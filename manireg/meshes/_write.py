"""Meshes into files, with coordinates as exact as they are.

trimesh writes them; its default is single precision.
"""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import trimesh

SINGLE = 1e-7  # of the size: single precision is written where it moves nothing by more


def write_mesh(mesh: trimesh.Trimesh, file: str | os.PathLike[str]) -> Path:
    """Write `mesh` with its vertex numbers; returns the file written. OBJ and OFF hold
    coordinates exactly. PLY and STL are in single precision where that moves no vertex by
    more than 1e-7 of the size of the mesh, else in double precision (STL: as text). Other
    formats are in single precision: where it is too coarse, a PLY file is written instead.

    **Example:**

    ```python
    mr.meshes.write_mesh(trimesh.creation.icosphere(subdivisions=2), "ball.ply")
    ```
    """
    path = Path(file)
    suffix, vertices = path.suffix.lower(), np.asarray(mesh.vertices)
    coarse = np.abs(vertices.astype(np.float32) - vertices).max(initial=0.0)
    single = coarse <= SINGLE * np.ptp(vertices, axis=0).max(initial=0.0)
    if suffix in (".obj", ".off"):
        path.write_text(_obj(mesh) if suffix == ".obj" else _off(mesh))
    elif suffix == ".stl" and not single:
        mesh.export(path, file_type="stl_ascii")
    elif single:
        mesh.export(path)
    else:
        path = path.with_suffix(".ply")
        path.write_bytes(_double_ply(mesh))
    return path


def _rows(array: np.ndarray, start: str) -> Iterator[str]:
    return (f"{start}{' '.join(map(repr, row))}" for row in array.tolist())


def _obj(mesh: trimesh.Trimesh) -> str:
    return "\n".join([*_rows(mesh.vertices, "v "), *_rows(mesh.faces + 1, "f "), ""])


def _off(mesh: trimesh.Trimesh) -> str:
    counts = f"{len(mesh.vertices)} {len(mesh.faces)} 0"
    rows = [*_rows(mesh.vertices, ""), *_rows(mesh.faces, "3 ")]
    return "\n".join(["OFF", counts, *rows, ""])


def _double_ply(mesh: trimesh.Trimesh) -> bytes:
    faces = np.zeros(len(mesh.faces), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(mesh.vertices)}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    vertices = np.asarray(mesh.vertices, "<f8")
    return "\n".join(header).encode() + vertices.tobytes() + faces.tobytes()
