"""Distances of points to the triangles of a mesh, exact."""

import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy.spatial import KDTree

CHUNK = 200_000  # pairs of a point and a triangle at a time


def mesh_distance(
    x: Float[np.ndarray, "q 3"],
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
) -> Float[np.ndarray, " q"]:
    """Only triangles whose circle around the centroid comes nearer than the best one so
    far are looked at, those of one size at a time, the smallest first."""
    corners = vertices[faces]
    centroids = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centroids[:, None], axis=2).max(axis=1)
    best = KDTree(corners.reshape(-1, 3)).query(x)[0]
    least = max(radii.max() * 1e-6, np.finfo(float).tiny)
    sizes = np.floor(np.log2(np.maximum(radii, least))).astype(int)
    for size in np.unique(sizes):
        some = np.flatnonzero(sizes == size)
        tree, reach = KDTree(centroids[some]), radii[some].max()
        for part in np.array_split(np.arange(len(x)), 1 + len(x) // 5000):
            near = tree.query_ball_point(x[part], best[part] + reach)
            count = np.array([len(found) for found in near])
            if not count.sum():
                continue
            rows = np.repeat(part, count)
            found = some[np.concatenate([np.array(a, int) for a in near])]
            far = np.linalg.norm(x[rows] - centroids[found], axis=1) - radii[found]
            rows, found = rows[far <= best[rows]], found[far <= best[rows]]
            for a in range(0, len(rows), CHUNK):
                row, triangle = rows[a : a + CHUNK], found[a : a + CHUNK]
                closest = trimesh.triangles.closest_point(corners[triangle], x[row])
                np.minimum.at(best, row, np.linalg.norm(closest - x[row], axis=1))
    return best
