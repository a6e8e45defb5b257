"""What a point cloud may be made of."""

import numpy as np

from ..._input.numbers import as_numbers
from ...meshes._edges import connected
from .._membership import is_concrete


def checked_points(points, normals, distinct: bool) -> tuple[np.ndarray, np.ndarray]:
    points, normals = as_numbers("points", points), as_numbers("normals", normals)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise ValueError(
            f"points: expected shape (P, 3), or (P, 2) for a curve, found {points.shape}."
        )
    if normals.shape != points.shape:
        raise ValueError(
            f"normals: expected shape {points.shape}, one for each point, found "
            f"{normals.shape}."
        )
    for name, values in (("points", points), ("normals", normals)):
        bad = np.flatnonzero(~np.all(np.isfinite(values), axis=1))
        if len(bad):
            raise ValueError(
                f"{name}: {len(bad)} of {len(points)} hold NaN or infinity (first at "
                f"index {bad[0]}); remove these points."
            )
    repeated = len(points) - len(np.unique(points, axis=0)) if distinct else 0
    if repeated:
        raise ValueError(
            f"points: {repeated} of {len(points)} are repetitions of others; drop them "
            "(numpy.unique); of a mesh take PointCloud.from_mesh(mesh)."
        )
    largest = np.max(np.abs(normals), axis=1, keepdims=True, initial=0.0)
    normals = normals / np.where(largest > 0, largest, 1.0)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    zero = np.flatnonzero(largest[:, 0] <= 1e-12 * np.max(largest, initial=0.0))
    if len(zero):
        raise ValueError(
            f"normals: {len(zero)} have no length (first at index {zero[0]}); vertices of "
            "degenerate triangles do: remove those."
        )
    return points, normals / lengths


def checked_triangles(triangles, points) -> np.ndarray:
    triangles = np.asarray(triangles)
    good = triangles.ndim == 2 and triangles.shape[1] == points.shape[1] == 3
    if not good or triangles.dtype.kind not in "iu":
        raise ValueError(
            "triangles: expected whole numbers of shape (T, 3) and points in space, found "
            f"{triangles.dtype} of shape {triangles.shape} and points {points.shape}."
        )
    beyond = np.any((triangles < 0) | (triangles >= len(points)), axis=1)
    if np.any(beyond):
        raise ValueError(
            f"triangles: {np.sum(beyond)} have corners that are no points (first at index "
            f"{np.argmax(beyond)}); there are {len(points)}, numbered from 0."
        )
    unused = np.bincount(triangles.ravel(), minlength=len(points)) == 0
    if np.any(unused):
        raise ValueError(
            f"triangles: {np.sum(unused)} points are in none (first: {np.argmax(unused)});"
            " take PointCloud.from_mesh, which drops them."
        )
    return triangles


def check_areas(areas, points) -> None:
    areas = as_numbers("areas", areas)
    if areas.shape != (len(points),) or not np.all(areas > 0) or np.isinf(areas).any():
        raise ValueError(
            f"areas: expected {len(points)} positive numbers, one for each point, found "
            f"shape {areas.shape}, least {np.min(areas, initial=np.inf):.3g}."
        )


def check_sides(points, normals, near, distance):
    """Next to each other along the surface, normals have to agree."""
    offset = points[near] - points[:, None]
    along = np.abs(np.einsum("pks,ps->pk", offset, normals)) < 0.2 * distance
    along &= distance < 2 * distance[:, :1]
    opposite = np.einsum("pks,ps->pk", normals[near], normals) < -0.7
    flipped = np.flatnonzero(np.sum(along & opposite, axis=1) >= 2)
    if len(flipped) > max(3, 2e-3 * len(points)):
        raise ValueError(
            f"normals: at {len(flipped)} points (first at index {flipped[0]}) the "
            "neighbours' normals point to the other side of the surface. Turn those of "
            "one side, normals[i] = -normals[i], or take PointCloud.from_mesh(mesh), "
            "where the triangles say what is next to each other."
        )


def check_one_piece(triangles, n: int) -> None:
    """Of the `n` corners of `triangles`, if there are any."""
    if triangles is None or not is_concrete(triangles):
        return
    pairs = np.asarray(triangles)
    part = connected(np.concatenate([pairs[:, :2], pairs[:, 1:]]), n)
    sizes = np.sort(np.bincount(part))[::-1]
    if len(sizes) > 1:
        listed = ", ".join(map(str, sizes[:5])) + (", ..." if len(sizes) > 5 else "")
        raise ValueError(
            f"source: {len(sizes)} components that do not touch ({listed} points); a map "
            "of the surface itself is smooth on one. Take "
            "`manireg.load_surface(mesh).largest().cloud`, or `Ambient(cloud)`."
        )
