"""One data set: a clean source with triangles, a noisy scan of the target, landmarks, and
the exact image to measure against."""

import functools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.spatial import KDTree

import manireg as mr

from .shapes import SHAPES, Shape

SOURCE_POINTS, TARGET_POINTS = 2000, 10_000
NOISE = 5e-4  # of the size, per coordinate: 1/20 of the spacing of the scan
NEIGHBOURS = 30  # of the scan's fits
FIRST_SEED = 2000  # seeds that no test or notebook uses


class Data(NamedTuple):
    shape: Shape
    uv: np.ndarray
    """Chart coordinates of the source's vertices."""
    faces: np.ndarray
    areas: np.ndarray
    """Share of each vertex in the area of the source."""
    vertices: np.ndarray
    truth: np.ndarray
    """The exact images of the vertices, without noise."""
    source: mr.PointCloud
    target: mr.PointCloud
    landmarks: np.ndarray
    """Vertex numbers."""
    places: np.ndarray
    """Where the landmarks belong, exactly: someone knows what he points at, the scanner
    is what is noisy."""


@functools.lru_cache(maxsize=1)  # all methods of a data set come one after the other
def make_data(name: str, k: int, seed: int) -> Data:
    shape = SHAPES[name]
    rng = np.random.default_rng([FIRST_SEED + seed, k, list(SHAPES).index(name)])
    uv, faces = grid(shape, SOURCE_POINTS)
    vertices, normals = shape.source(uv)
    truth, _ = shape.target(uv)
    areas = vertex_areas(vertices, faces)
    scan, sides = scanned(shape, TARGET_POINTS, rng)
    landmarks = spread(in_space(shape, uv), k, rng)
    return Data(
        shape,
        uv,
        faces,
        areas,
        vertices,
        truth,
        mr.PointCloud(vertices, normals, areas=areas),
        mr.PointCloud(scan, sides, neighbours=NEIGHBOURS),
        landmarks,
        truth[landmarks],
    )


def grid(shape: Shape, n: int) -> tuple[np.ndarray, np.ndarray]:
    """About `n` chart points, boundary included, in nearly square cells; triangles."""
    a, b = shape.lengths
    rows = round(np.sqrt(n * a / b))
    columns = round(n / rows)
    u = np.linspace(0, a, rows)
    v = np.linspace(0, b, columns, endpoint=not shape.periodic)
    uv = np.stack(np.meshgrid(u, v, indexing="ij"), -1).reshape(-1, 2)
    index = np.arange(rows * columns).reshape(rows, columns)
    if shape.periodic:
        index = np.column_stack([index, index[:, 0]])
    low, high = index[:-1], index[1:]
    p, q, r, s = (
        a.ravel() for a in (low[:, :-1], high[:, :-1], high[:, 1:], low[:, 1:])
    )
    faces = np.concatenate([np.column_stack([p, q, r]), np.column_stack([p, r, s])])
    return uv, faces


def vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """A third of the triangles around each."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    triangles = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return np.bincount(faces.ravel(), np.repeat(triangles / 3, 3), len(vertices))


def scanned(shape: Shape, n: int, rng: np.random.Generator):
    """`n` irregular points with normals, moved by noise; the normals are off by about the
    slope of the noise over the spacing."""
    uv = thinned(rng.uniform(size=(4 * n, 2)) * shape.lengths, n)
    points, normals = shape.target(uv)
    points = points + NOISE * shape.size * rng.normal(size=points.shape)
    slope = 0.5 * NOISE * np.sqrt(n)
    return points, normals + slope * rng.normal(size=points.shape)


def thinned(uv: np.ndarray, n: int) -> np.ndarray:
    """Drop those with the closest neighbours, half of the surplus at a time."""
    while len(uv) > n:
        gap = KDTree(uv).query(uv, k=2)[0][:, 1]
        surplus = (len(uv) - n + 1) // 2
        uv = np.delete(uv, np.argsort(gap)[:surplus], axis=0)
    return uv


def in_space(shape: Shape, uv: np.ndarray) -> np.ndarray:
    """The chart, rolled up where it closes: neighbours there are neighbours here."""
    if not shape.periodic:
        return uv
    radius = shape.lengths[1] / (2 * np.pi)
    angle = uv[:, 1] / radius
    return np.column_stack([uv[:, 0], radius * np.cos(angle), radius * np.sin(angle)])


def spread(points: np.ndarray, k: int, rng: np.random.Generator) -> np.ndarray:
    """Farthest points from a random first one: corners and edges are among them."""
    chosen = [int(rng.integers(len(points)))]
    distance = np.full(len(points), np.inf)
    while len(chosen) < k:
        latest = points[chosen[-1]]
        distance = np.minimum(distance, np.sum((points - latest) ** 2, axis=1))
        chosen.append(int(np.argmax(distance)))
    return np.array(chosen)


def errors(data: Data, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each vertex, in units of the size: distance to the exact image in space, and
    along the exact target, whose chart is an isometry on all shapes here."""
    shape = data.shape
    in_space_ = np.linalg.norm(image - data.truth, axis=1)
    fine, _ = grid(shape, 200_000)
    near = fine[KDTree(shape.target(fine)[0]).query(image)[1]]
    base, step, uv = shape.target(near)[0], 1e-5, near.copy()
    for axis in range(2):  # from the nearest grid point along the tangents
        ahead = near + step * np.eye(2)[axis]
        tangent = (shape.target(ahead)[0] - base) / step
        uv[:, axis] += np.sum((image - base) * tangent, axis=1)
    offset = uv - data.uv
    if shape.periodic:
        around = shape.lengths[1]
        offset[:, 1] -= around * np.round(offset[:, 1] / around)
    return in_space_ / shape.size, np.linalg.norm(offset, axis=1) / shape.size


def mean(data: Data, values: np.ndarray) -> float:
    """Over the area of the source."""
    return float(np.average(values, weights=data.areas))


def project(target: mr.PointCloud, points: np.ndarray) -> np.ndarray:
    return np.asarray(target.project(jnp.asarray(points)))
