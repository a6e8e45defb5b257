"""What a point cloud works out once, on the host, about all its points: checks, quadrics,
areas."""

import numpy as np

from .._numbers import as_numbers


def checked_points(points, normals) -> tuple[np.ndarray, np.ndarray]:
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
    repeated = len(points) - len(np.unique(points, axis=0))
    if repeated:
        raise ValueError(
            f"points: {repeated} of {len(points)} are repetitions of others; drop them "
            "(numpy.unique), or merge the vertices of the mesh."
        )
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    zero = np.flatnonzero(lengths[:, 0] < 1e-12)
    if len(zero):
        raise ValueError(
            f"normals: {len(zero)} have no length (first at index {zero[0]}); vertices of "
            "degenerate triangles do: remove those."
        )
    return points, normals / lengths


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
            "neighbours' normals point to the other side of the surface. Orient them "
            "alike, e.g. with trimesh.repair.fix_normals(mesh)."
        )


def fitted_quadrics(points, normals, frames, near):
    """Slope and bending of each patch, by weighted least squares."""
    m = frames.shape[2]
    offset = points[near] - points[:, None]
    u = np.einsum("pks,psm->pkm", offset, frames)
    height = np.einsum("pks,ps->pk", offset, normals)
    radius = np.sqrt(np.max(np.sum(u**2, axis=2), axis=1))[:, None]
    u, height = u / radius[:, :, None], height / radius
    r = np.linalg.norm(u, axis=2) / 1.5
    weights = (1 - r) ** 4 * (4 * r + 1)
    weights *= np.einsum("pks,ps->pk", normals[near], normals) > 0
    rows, cols = np.triu_indices(m)
    quadratic = u[:, :, rows] * u[:, :, cols] * np.where(rows == cols, 0.5, 1.0)
    design = np.concatenate([u, quadratic], axis=2)
    weighted = design * weights[:, :, None]
    gram = np.einsum("pki,pkj->pij", weighted, design)
    # where too few neighbours are left the surface is flat
    gram += (
        1e-6 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(len(gram[0]))
    )
    gram += 1e-300 * np.eye(len(gram[0]))
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
