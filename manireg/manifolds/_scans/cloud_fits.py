"""What a point cloud works out once, on the host, about all its points: checks, quadrics,
areas."""

import numpy as np
import scipy.sparse as sp
from scipy.spatial import KDTree

from ..._input.numbers import as_numbers

HUB = 50  # neighbours of a vertex through which no ring goes on
EQUAL = 1e-6  # distances that differ by a smaller share are equal: the lower index wins


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


def cloud_neighbours(points, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices and distances `(P, k)` of the nearest, in order."""
    found = KDTree(points).query(points, k=min(k + 9, len(points)))
    distance, near = (np.asarray(a)[:, 1:] for a in found)  # without the point itself
    order = np.lexsort((near, _ranks(distance)), axis=1)[:, :k]
    take = lambda a: np.take_along_axis(a, order, axis=1)
    return take(near), take(distance)


def mesh_neighbours(points, normals, triangles, k: int) -> np.ndarray:
    """Indices `(P, k)` of the nearest of those a few edges away, first those on the same
    side; where there are too few, the point itself fills the row."""
    P, start, end = len(points), triangles, np.roll(triangles, 1, axis=1)
    ends = np.concatenate([start, end]).ravel(), np.concatenate([end, start]).ravel()
    edges = sp.csr_array((np.ones(len(ends[0]), bool), ends), shape=(P, P))
    few = (np.diff(edges.indptr) <= HUB).astype(bool)
    onwards = sp.csr_array(edges.multiply(few[:, None]))
    reach, ring = edges, 1
    while 3 * ring * (ring + 1) < 2 * k:  # points within so many rings, mostly
        reach, ring = sp.csr_array(reach + reach @ onwards), ring + 1
    reach.setdiag(False)
    reach.eliminate_zeros()
    reach.sort_indices()
    count = np.diff(reach.indptr)
    rows, cols = np.repeat(np.arange(P), count), reach.indices
    rank = _ranks(np.linalg.norm(points[cols] - points[rows], axis=1))
    rank += (np.einsum("es,es->e", normals[rows], normals[cols]) <= 0) * (
        np.ptp(rank) + 1
    )
    order = np.argsort(rows * (np.ptp(rank) + 1) + rank - rank.min(), kind="stable")
    place = np.arange(len(rows)) - np.repeat(reach.indptr[:-1], count)
    near = np.repeat(np.arange(P)[:, None], k, axis=1)
    near[rows[place < k], place[place < k]] = cols[order][place < k]
    return near


def _ranks(distance) -> np.ndarray:
    """Whole numbers in the order of distances, up to a constant the same after a change of
    unit or origin."""
    least = np.finfo(float).tiny
    return np.round(np.log(np.maximum(distance, least)) / EQUAL).astype(int)


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
