"""What a point cloud works out once, on the host, about all its points: quadrics and
areas."""

from typing import NamedTuple

import numpy as np

from ..._input.numbers import as_numbers
from .cloud_checks import check_areas, check_sides, checked_points, checked_triangles
from .neighbours import cloud_neighbours, mesh_neighbours, same_side_first


class CloudFits(NamedTuple):
    """The fields of a `PointCloud` that are worked out."""

    points: np.ndarray
    normals: np.ndarray
    frames: np.ndarray
    slopes: np.ndarray
    bendings: np.ndarray
    areas: np.ndarray
    triangles: np.ndarray | None


def fitted_cloud(points, normals, neighbours, areas, triangles) -> CloudFits:
    """From the arguments of a `PointCloud`, which are checked."""
    points, normals = checked_points(points, normals, distinct=triangles is None)
    s = points.shape[1]
    if neighbours is None:
        neighbours = min({2: 6, 3: 12}[s], len(points) - 1)
    least = {2: 3, 3: 6}[s]
    if len(points) <= least:
        raise ValueError(
            f"points: {len(points)} are too few to tell how they bend, at least "
            f"{least + 1} are needed. Subdivide a mesh (`mesh.subdivide()`)."
        )
    if not least <= neighbours < len(points):
        raise ValueError(
            f"neighbours: must be at least {least} and less than the number of "
            f"points, {len(points)}; found {neighbours}."
        )
    frames = plane_frames(normals)
    if triangles is None:
        near, distance = cloud_neighbours(points, neighbours)
        check_sides(points, normals, near[:, :12], distance[:, :12])
        near, distance = same_side_first(points, normals, near, distance)
        if areas is None:
            areas = voronoi_areas(points, normals, frames, near, distance)
    else:
        triangles = checked_triangles(triangles, points)
        near = mesh_neighbours(points, normals, triangles, neighbours)
        if areas is None:
            areas = corner_areas(points, triangles)
    slopes, bendings = fitted_quadrics(points, normals, frames, near)
    areas = as_numbers("areas", areas)
    check_areas(areas, points)
    return CloudFits(points, normals, frames, slopes, bendings, areas, triangles)


def corner_areas(points, triangles) -> np.ndarray:
    """A third of the triangles around each point."""
    third = np.repeat(triangle_areas(points[triangles]) / 3, 3)
    return np.bincount(triangles.ravel(), third, minlength=len(points))


def triangle_areas(corners) -> np.ndarray:
    """Of triangles by their corners `(T, 3, 3)`."""
    a, b, c = np.moveaxis(corners, 1, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def points_in_triangles(corners: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """At least `n` points in triangles with corners `(T, 3, 3)`, each cut into equal ones,
    and the areas of these. The points are a little beside the centroids, which several
    vertices may be nearest to: rounding would choose the patch."""
    cuts = int(np.ceil(np.sqrt(n / len(corners))))
    i, j = np.indices((cuts, cuts)).reshape(2, -1)
    upright, upturned = i + j < cuts, i + j < cuts - 1
    u, v = (
        np.concatenate([a[upright] + 1 / 3, a[upturned] + 2 / 3]) + beside
        for a, beside in ((i, 0.02), (j, -0.005))
    )
    u, v = u / cuts, v / cuts
    share = np.stack([1 - u - v, u, v], axis=1)
    points = np.einsum("qc,tcs->tqs", share, corners).reshape(-1, 3)
    return points, np.repeat(triangle_areas(corners) / cuts**2, len(share))


def plane_frames(normals) -> np.ndarray:
    """Orthonormal columns `(P, s, m)` across the normals. The decomposition jumps where a
    component changes its sign, so rounding must not decide on that."""
    snapped = np.where(np.abs(normals) < 1e-7, 0.0, normals)
    frames = np.linalg.svd(snapped[:, None, :])[2][:, 1:, :].transpose(0, 2, 1)
    along = np.einsum("ps,psm->pm", normals, frames)
    return frames - normals[:, :, None] * along[:, None, :]


def fitted_quadrics(points, normals, frames, near):
    """Slope and bending of each patch, by weighted least squares."""
    m = frames.shape[2]
    offset = points[near] - points[:, None]
    u = np.einsum("pks,psm->pkm", offset, frames)
    height = np.einsum("pks,ps->pk", offset, normals)
    radius = np.sqrt(np.max(np.sum(u**2, axis=2), axis=1))[:, None]
    radius = np.where(radius > 0, radius, 1.0)
    u, height = u / radius[:, :, None], height / radius
    r = np.linalg.norm(u, axis=2) / 1.5
    weights = (1 - r) ** 4 * (4 * r + 1)
    weights *= np.einsum("pks,ps->pk", normals[near], normals) > 0
    rows, cols = np.triu_indices(m)
    quadratic = u[:, :, rows] * u[:, :, cols] * np.where(rows == cols, 0.5, 1.0)
    design = np.concatenate([u, quadratic], axis=2)
    weighted = design * weights[:, :, None]
    gram = np.einsum("pki,pkj->pij", weighted, design)
    # where too few neighbours are left the surface is flat; |slope|^2 + |bending|^2 does
    # not depend on the frame
    metric = np.append(np.ones(m), np.where(rows == cols, 1.0, 2.0))
    ridge = 1e-6 * np.sum(np.diagonal(gram, axis1=1, axis2=2) / metric, axis=1) + 1e-300
    gram += ridge[:, None, None] * np.diag(metric)
    rhs = np.einsum("pki,pk->pi", weighted, height)[:, :, None]
    solution = np.linalg.solve(gram, rhs)[:, :, 0]
    bending = np.zeros((len(points), m, m))
    bending[:, rows, cols] = bending[:, cols, rows] = solution[:, m:] / radius
    return solution[:, :m], bending


def voronoi_areas(points, normals, frames, near, distance):
    """Share of a disc around each point, in the tangent plane, that is nearest to it
    rather than to one of its neighbours. The disc reaches just beyond a usual cell, so
    that cells at a boundary end there."""
    m = frames.shape[2]
    side = int(round(1600 ** (1 / m)))
    ticks = (np.arange(side) + 0.5) / side * 2 - 1
    disc = np.stack(np.meshgrid(*[ticks] * m), -1).reshape(-1, m)
    disc = disc[np.sum(disc**2, axis=1) <= 1]
    cell = (2.0 / side) ** m
    ring = {1: 2, 2: 6}[m]
    radius = np.median(distance[:, :ring], axis=1)
    areas = np.zeros(len(points))
    for chunk in np.array_split(np.arange(len(points)), max(1, len(points) // 2000)):
        offset = points[near[chunk]] - points[chunk, None]
        u = np.einsum("pks,psm->pkm", offset, frames[chunk])
        # |r x - u|^2 > |r x|^2  <=>  2 r x.u < |u|^2
        bound = np.sum(u**2, 2) / (2 * radius[chunk, None])
        own = disc @ u.transpose(0, 2, 1) < bound[:, None]
        same = np.einsum("pks,ps->pk", normals[near[chunk]], normals[chunk]) > 0
        inside = np.sum(np.all(own | ~same[:, None], axis=2), axis=1)
        areas[chunk] = inside * cell * radius[chunk] ** m
    return areas
