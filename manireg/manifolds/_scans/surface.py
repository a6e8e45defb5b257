"""Surfaces as they are given: files, meshes, points; cleaned once, numbered as given."""

import os

import equinox as eqx
import numpy as np
import trimesh
from jaxtyping import ArrayLike, Float, Int

from ..._input.numbers import as_numbers
from ...meshes._clean import LEAST_SHARE, mesh_surface
from ...meshes._points import points_surface
from ...meshes._read import FilePoints, numbers_vertices, read_surface
from ...meshes._report import Report
from .point_cloud import PointCloud


class Surface(eqx.Module):
    """A surface as the user has it, and the clean one it stands for: what `load_surface`
    returns. Results refer to `vertices`, computations to `cloud`."""

    cloud: PointCloud
    """Its `of_vertex` is None, so that programs are shared whatever a mesh repeats or
    leaves out."""
    vertices: Float[np.ndarray, "n 3"]
    """As given, in the user's order and unit."""
    faces: Int[np.ndarray, "f 3"] | None
    """As given; None for points without triangles."""
    of_vertex: Int[np.ndarray, " n"]
    """The point of the cloud each vertex is; the nearest, where no triangle that is kept
    uses it."""
    components: int = eqx.field(static=True)
    """Parts that do not touch, of those kept; 1 for points without triangles."""
    numbered: bool = eqx.field(static=True)
    """Whether vertices can be named by number: not in STL files."""
    report: Report = eqx.field(static=True)
    """What was found and what was done about it; `print` lists it."""

    @property
    def centre(self) -> Float[np.ndarray, "3"]:
        """The middle of the box around the surface."""
        points = np.asarray(self.cloud.points)
        lower = points.min(axis=0)
        return lower + np.ptp(points, axis=0) / 2

    @property
    def size(self) -> float:
        """Diagonal of the box around the surface."""
        return float(np.linalg.norm(np.ptp(np.asarray(self.cloud.points), axis=0)))

    @property
    def places(self) -> Float[np.ndarray, "n 3"]:
        """The vertices; one of NaN is where its point is."""
        there = np.all(np.isfinite(self.vertices), axis=1)[:, None]
        points = np.asarray(self.cloud.points)[self.of_vertex]
        return np.where(there, self.vertices, points)

    def largest(self) -> "Surface":
        """The surface with its largest component alone, the vertices as they are."""
        if self.components == 1:
            return self
        mesh = trimesh.Trimesh(self.vertices, self.faces, process=False)
        return _of_mesh(mesh, self.numbered, least_share=1.0)


SurfaceLike = (
    Surface
    | trimesh.Trimesh
    | trimesh.PointCloud
    | PointCloud
    | str
    | os.PathLike
    | ArrayLike
)


def load_surface(
    surface: SurfaceLike,
    normals: ArrayLike | None = None,
    *,
    least_share: float = LEAST_SHARE,
) -> Surface:
    """The surface in a file, a mesh or points, repaired where the repair is certain.

    **Arguments:**

    - `surface`: a file that trimesh loads (PLY, OBJ, OFF, STL, GLB, XYZ, ...), a
      `trimesh.Trimesh` or `trimesh.PointCloud`, a `PointCloud`, or points `(n, 3)`; a
      `Surface` is returned as it is.
    - `normals`: `(n, 3)` of points, of any length. Where points have none they are
      estimated and given a side; the report says how sure that is.
    - `least_share`: components of less than this share of the area are left out (default
      a hundredth); at 1 all but the largest.

    Any unit and any distance from the origin will do. Vertices keep their numbers: those
    of seams, unused and repeated ones are mapped to the points of `.cloud` by
    `.of_vertex`. Repaired are: polygons (cut into triangles), vertices at one place where
    triangles end (one point), degenerate and repeated triangles (left out), triangles
    wound against their neighbours (turned), vertices of NaN (left out with their
    triangles). Holes and edges of three triangles stay as they are. `.report` tells.

        surface = mr.load_surface("skull.ply")
        print(surface.report)

    **Raises** ValueError for a file that cannot be read, for what leaves fewer than 7
    points, triangles whose vertices do not exist, surfaces of one side only (a Moebius
    strip), and points whose normals change sides along the surface.

    **Example:**

    ```python
    surface = mr.load_surface(trimesh.creation.icosphere(subdivisions=2))
    print(surface.report)
    len(surface.cloud.points)  # 162
    ```
    """
    if isinstance(surface, Surface):
        return surface
    if isinstance(surface, PointCloud):
        return _of_cloud(surface)
    if isinstance(surface, trimesh.Trimesh):
        return _of_mesh(surface, True, least_share)
    if isinstance(surface, trimesh.PointCloud):
        return _of_points(np.asarray(surface.vertices), normals)
    if not isinstance(surface, str | os.PathLike):
        if isinstance(surface, trimesh.Scene) or not hasattr(surface, "__len__"):
            raise ValueError(
                "surface: expected a file, a trimesh.Trimesh, a PointCloud or points "
                f"(n, 3), found {type(surface).__name__}."
            )
        return _of_points(as_numbers("points", surface), normals)
    loaded = read_surface(surface)
    if isinstance(loaded, FilePoints):
        return _of_points(loaded.points, loaded.normals if normals is None else normals)
    return _of_mesh(loaded, numbers_vertices(surface), least_share)


def _of_mesh(mesh: trimesh.Trimesh, numbered: bool, least_share: float) -> Surface:
    found = mesh_surface(mesh, least_share)
    cloud = PointCloud(
        found.points, found.normals, areas=found.areas, triangles=found.triangles
    )
    vertices = np.asarray(mesh.vertices, dtype=float)
    faces, of_vertex = np.asarray(mesh.faces), found.of_vertex
    more = found.components, numbered, found.report
    return Surface(cloud, vertices, faces, of_vertex, *more)


def _of_points(points, normals) -> Surface:
    points = np.array(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(
            f"points: expected shape (n, 3), found {points.shape}; for curves take "
            "`PointCloud`."
        )
    if normals is not None:
        normals = np.array(normals, dtype=float)
        if normals.shape != points.shape:
            raise ValueError(
                f"normals: expected shape {points.shape}, one for each point, found "
                f"{normals.shape}."
            )
    if not np.any(np.all(np.isfinite(points), axis=1)):
        raise ValueError(f"points: none of {len(points)} is finite.")
    found = points_surface(points, normals)
    cloud = PointCloud(found.points, found.normals)
    return Surface(cloud, points, None, found.of_vertex, 1, True, found.report)


def _of_cloud(cloud: PointCloud) -> Surface:
    if cloud.dim != 2:
        raise ValueError("surface: a curve in the plane; expected points (n, 3).")
    points, numbers = np.asarray(cloud.points), cloud.of_vertex
    numbers = np.arange(len(points)) if numbers is None else np.asarray(numbers)
    is_none = lambda leaf: leaf is None
    bare = eqx.tree_at(lambda c: c.of_vertex, cloud, None, is_leaf=is_none)
    extent = float(np.max(np.ptp(points, axis=0)))
    triangles = 0 if cloud.triangles is None else len(cloud.triangles)
    report = Report(len(numbers), triangles, extent, ())
    return Surface(bare, points[numbers], None, numbers, 1, True, report)
