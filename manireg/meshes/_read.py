"""Files of meshes and points: vertices as they are numbered in the file.

trimesh reads them. Its defaults are for rendering: they merge, split and sort vertices.
"""

import io
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
from jaxtyping import Float

UNIT = 1e-2  # of 1: columns after the coordinates that are so long are normals


class FilePoints(NamedTuple):
    """Points of a file without triangles, with normals if it has them."""

    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"] | None


def read_mesh(file: str | os.PathLike[str]) -> trimesh.Trimesh:
    """The mesh in a file that trimesh loads, with the vertices of the file in the order
    of the file: none merged, none split at seams of the texture, none dropped. Polygons
    are cut into triangles. STL files do not number vertices: equal corners become one,
    in the order of their first appearance.

    **Raises** ValueError for a file that cannot be read or holds no triangles.

    **Example:**

    ```python
    mr.meshes.write_mesh(trimesh.creation.icosphere(subdivisions=2), "ball.obj")
    len(mr.meshes.read_mesh("ball.obj").vertices)  # 162
    ```
    """
    found = read_surface(file)
    if isinstance(found, FilePoints):
        raise ValueError(
            f"mesh: {os.fspath(file)!r} holds no triangles, but {len(found.points)} "
            "points; take `manireg.load_surface`."
        )
    return found


def read_surface(file: str | os.PathLike[str]) -> trimesh.Trimesh | FilePoints:
    """The mesh in a file, or where it has no triangles its points."""
    path = Path(file).expanduser()
    try:
        if path.suffix.lower() in (".xyz", ".txt", ".asc", ".pts"):
            return _rows_of_points(path)
        found = _with_trimesh(path)
    except Exception as error:  # trimesh raises many types
        raise ValueError(
            f"mesh: trimesh cannot load {os.fspath(file)!r}: {error}."
        ) from error
    if isinstance(found, FilePoints):
        if not len(found.points):
            raise ValueError(f"mesh: {os.fspath(file)!r} holds no triangles.")
        return found
    return found if numbers_vertices(path) else _welded(found)


def numbers_vertices(file: str | os.PathLike[str]) -> bool:
    """Whether the format of the file has vertex numbers."""
    return Path(file).suffix.lower() not in (".stl", ".stl_ascii")


def _with_trimesh(path: Path) -> trimesh.Trimesh | FilePoints:
    options = {"process": False, "maintain_order": True}
    if path.suffix.lower() == ".obj":
        text = path.read_bytes().decode(errors="replace")
        plain = lambda: io.BytesIO(_plain_obj(text))
        mesh = trimesh.load_mesh(plain(), file_type="obj", **options)
        if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
            return mesh
        cloud: Any = trimesh.load(plain(), file_type="obj")
        points = np.asarray(getattr(cloud, "vertices", np.zeros((0, 3))), float)
        return FilePoints(points, _like(points, _numbers(text, "vn")))
    mesh = trimesh.load_mesh(path, fix_texture=False, **options)
    if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
        return mesh
    cloud = trimesh.load(path, process=False)
    points = np.asarray(getattr(cloud, "vertices", np.zeros((0, 3))), float)
    columns = cloud.metadata.get("_ply_raw", {}).get("vertex", {}).get("data", {})
    names = ("nx", "ny", "nz")
    if any(name not in columns for name in names):
        return FilePoints(points, None)
    normals = np.stack([np.asarray(columns[n], float).ravel() for n in names], axis=1)
    return FilePoints(points, _like(points, normals))


def _rows_of_points(path: Path) -> FilePoints:
    """A point a line: coordinates, then perhaps a normal, or colours."""
    rows = []
    for line in path.read_text(errors="replace").splitlines():
        words = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
        if len(words) >= 3:  # some start with the number of points
            rows.append([float(word) for word in words[:6]])
    width = min(map(len, rows), default=0)
    table = np.array([row[:width] for row in rows], float).reshape(len(rows), width)
    if width < 3:
        raise ValueError("no line has three numbers")
    points, more = table[:, :3], table[:, 3:]
    length = np.linalg.norm(more, axis=1)
    normals = more.shape[1] == 3 and np.all(np.abs(length - 1) < UNIT)
    return FilePoints(points, more if normals else None)


def _numbers(text: str, letter: str) -> np.ndarray:
    words = [line.split() for line in text.splitlines() if line.startswith(letter)]
    return np.array([[float(w) for w in row[1:4]] for row in words if row[0] == letter])


def _like(points, normals) -> np.ndarray | None:
    return normals if normals.shape == points.shape else None


def _plain_obj(text: str) -> bytes:
    """Vertices and faces only, numbered from the start of the file: by texture, normals
    and materials trimesh would split vertices, and it drops unused ones at the end."""
    lines, vertices = [], 0
    for line in text.replace("\\\r\n", " ").replace("\\\n", " ").splitlines():
        words = line.partition("#")[0].split()
        if words[:1] == ["v"]:
            vertices += 1
            words = words[:4]  # some add a weight or a colour
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
