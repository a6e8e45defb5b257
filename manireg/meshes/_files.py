"""Mesh files: vertices as they are numbered in the file, coordinates as exact as they are.

trimesh reads and writes them. Its defaults are for rendering: they merge, split and sort
vertices, and write single precision.
"""

import io
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import trimesh

SINGLE = 1e-7  # of the size: single precision is written where it moves nothing by more


def read_mesh(file: str | os.PathLike[str]) -> trimesh.Trimesh:
    """The mesh in a file that trimesh loads, with the vertices of the file in the order
    of the file: none merged, none split at seams of the texture, none dropped. Polygons
    are cut into triangles. STL files do not number vertices: equal corners become one,
    in the order of their first appearance.

    **Raises** ValueError for a file that cannot be read or holds no triangles."""
    path = Path(file)
    options = {"process": False, "maintain_order": True}
    try:
        if path.suffix.lower() == ".obj":
            text = io.BytesIO(_plain_obj(path.read_bytes().decode(errors="replace")))
            mesh = trimesh.load_mesh(text, file_type="obj", **options)
        else:
            mesh = trimesh.load_mesh(path, fix_texture=False, **options)
    except Exception as error:  # trimesh raises many types
        raise ValueError(
            f"mesh: trimesh cannot load {os.fspath(file)!r}: {error}."
        ) from error
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise ValueError(f"mesh: {os.fspath(file)!r} holds no triangles.")
    return mesh if numbers_vertices(path) else _welded(mesh)


def numbers_vertices(file: str | os.PathLike[str]) -> bool:
    """Whether the format of the file has vertex numbers."""
    return Path(file).suffix.lower() not in (".stl", ".stl_ascii")


def write_mesh(mesh: trimesh.Trimesh, file: str | os.PathLike[str]) -> Path:
    """Write `mesh` with its vertex numbers; returns the file written. OBJ and OFF hold
    coordinates exactly. PLY and STL are in single precision where that moves no vertex by
    more than 1e-7 of the size of the mesh, else in double precision (STL: as text). Other
    formats are in single precision: where it is too coarse, a PLY file is written instead.
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


def _plain_obj(text: str) -> bytes:
    """Vertices and faces only, numbered from the start of the file: by texture, normals
    and materials trimesh would split vertices, and it drops unused ones at the end."""
    lines, vertices = [], 0
    for line in text.replace("\\\r\n", " ").replace("\\\n", " ").splitlines():
        words = line.partition("#")[0].split()
        if words[:1] == ["v"]:
            vertices += 1
        elif words[:1] == ["f"]:
            corners = (int(word.partition("/")[0]) for word in words[1:])
            words = ["f", *(str(c + vertices + 1 if c < 0 else c) for c in corners)]
        else:
            continue
        lines.append(" ".join(words))
    return "\n".join(lines).encode()


def _welded(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    _, first, same = np.unique(
        mesh.vertices, axis=0, return_index=True, return_inverse=True
    )
    rank = np.argsort(np.argsort(first))
    vertices = np.asarray(mesh.vertices)[np.sort(first)]
    return trimesh.Trimesh(vertices, rank[same.ravel()][mesh.faces], process=False)


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
