"""Shortest curves on scans with holes, slits and rims, against lengths by hand: straight
lines and arcs from corner to corner."""

import jax
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

import manireg as mr
from manireg._geodesics.facets import edges_in_one, facets

UP = np.array([0.0, 0.0, 1.0])


def sheet(keep, n=60):
    """The unit square in triangles, those with a centroid in `keep`."""
    x, y = np.meshgrid(*[np.linspace(0, 1, n + 1)] * 2, indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)
    k = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]
    corners = [np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    faces = np.concatenate(corners)
    return vertices, faces[keep(*vertices[faces].mean(axis=1)[:, :2].T)]


def meshed(vertices, faces):
    return mr.PointCloud.from_mesh(trimesh.Trimesh(vertices, faces, process=False))


def scattered(points):
    return mr.PointCloud(points, np.tile(UP, (len(points), 1)))


def round_hole(x, y):
    return np.hypot(x - 0.5, y - 0.5) > 0.3


def slit(x, y):
    """Six spacings wide."""
    return (np.abs(x - 0.5) > 0.05) | (y > 0.8)


def l_shape(x, y):
    return (x < 0.5) | (y < 0.5)


def taut_string(rim, p, q):
    """Round the convex hull of the rim of a hole."""
    points = np.concatenate([rim, [p, q]])[:, :2]
    hull = list(ConvexHull(points).vertices)
    start = hull.index(len(rim))
    hull = hull[start:] + hull[:start]
    end = hull.index(len(rim) + 1)
    ways = hull[: end + 1], [*hull[end:], hull[0]]
    length = lambda way: np.linalg.norm(np.diff(points[way], axis=0), axis=1).sum()
    return min(map(length, ways))


def test_round_a_hole():
    cloud = meshed(*sheet(round_hole))
    rim = np.asarray(cloud.points)[np.unique(edges_in_one(np.asarray(cloud.triangles)))]
    rim = rim[np.hypot(*(rim[:, :2] - 0.5).T) < 0.4]
    p = np.array([[0.1, 0.5, 0], [0.31, 0.05, 0], [0.93, 0.17, 0], [0.45, 0.04, 0]])
    q = np.array([[0.9, 0.5, 0], [0.6, 0.97, 0], [0.07, 0.83, 0], [0.71, 0.11, 0]])
    found = mr.geodesic(cloud, p, q)
    assert np.all(found.converged)
    exact = [taut_string(rim, *ends) for ends in zip(p[:3], q[:3], strict=True)]
    exact.append(np.linalg.norm(p[3] - q[3]))  # passes by
    np.testing.assert_allclose(found.length, exact, rtol=2e-4)
    circle = 2 * np.sqrt(0.16 - 0.09) + 0.3 * (np.pi - 2 * np.arccos(0.75))
    assert float(found.length[0]) == pytest.approx(circle, rel=0.015)  # jagged
    # steps are equal and lie on the sheet; triangles of the rim are a spacing wide
    assert np.hypot(*(found.points[..., :2] - 0.5).reshape(-1, 2).T).min() > 0.29
    steps = np.linalg.norm(np.diff(found.points, axis=1), axis=2)
    np.testing.assert_allclose(
        steps, np.mean(steps, 1, keepdims=True) + 0 * steps, 0.03
    )
    np.testing.assert_allclose(np.linalg.norm(found.velocity, axis=1), found.length)


def test_round_a_slit():
    exact = 2 * np.hypot(0.05, 0.7) + 0.1
    vertices, faces = sheet(slit)
    ends = np.array([0.4, 0.1, 0]), np.array([0.6, 0.1, 0])
    found = mr.geodesic(meshed(vertices, faces), *ends)
    assert found.converged
    assert float(found.length) == pytest.approx(exact, rel=1e-4)
    # points alone: the corners are round
    found = mr.geodesic(scattered(vertices[np.unique(faces)]), *ends)
    assert found.converged
    assert 0.96 * exact < float(found.length) < exact * 1.001


@pytest.mark.parametrize("width", [1e-3, 1e-6])
def test_round_a_cut(width):
    """Much thinner than the spacing, 1/60; half of it lies on either side."""
    vertices, faces = sheet(lambda x, y: x >= 0)
    cut = np.flatnonzero((vertices[:, 0] == 0.5) & (vertices[:, 1] < 0.79))
    twin = np.arange(len(vertices))
    twin[cut] = len(vertices) + np.arange(len(cut))
    right = vertices[faces].mean(axis=1)[:, 0] > 0.5
    faces = np.where(right[:, None], twin[faces], faces)
    half = np.array([width / 2, 0, 0])
    vertices = np.concatenate([vertices, vertices[cut] + half])
    vertices[cut] -= half
    found = mr.geodesic(
        meshed(vertices, faces), np.array([0.4, 0.1, 0]), np.array([0.6, 0.1, 0])
    )
    assert found.converged
    assert float(found.length) == pytest.approx(2 * np.hypot(0.1, 0.7), rel=1e-5)


def test_round_a_corner():
    ends = np.array([0.3, 0.95, 0]), np.array([0.95, 0.4, 0])
    exact = np.hypot(0.2, 0.45) + np.hypot(0.45, 0.1)
    vertices, faces = sheet(l_shape, 40)
    found = mr.geodesic(meshed(vertices, faces), *ends)
    assert found.converged
    assert float(found.length) == pytest.approx(exact, rel=1e-6)
    # in other units and far from the origin
    moved = lambda x: 1e3 * x + np.array([5e6, 4e5, 0.0])
    found = mr.geodesic(meshed(moved(vertices), faces), *map(moved, ends))
    assert found.converged
    assert float(found.length) == pytest.approx(1e3 * exact, rel=1e-6)
    scatter = np.random.default_rng(0).uniform(size=(3000, 2))
    scatter = scatter[l_shape(*scatter.T)]
    found = mr.geodesic(scattered(np.pad(scatter, ((0, 0), (0, 1)))), *ends)
    assert float(found.length) == pytest.approx(exact, rel=0.03)


def test_round_the_inside_of_a_ring():
    """The inner rim is a polygon."""
    angle = np.linspace(0, 2 * np.pi, 96, endpoint=False)
    radius = np.linspace(0.5, 1, 9)
    x = radius[:, None] * np.exp(1j * angle)
    vertices = np.stack([x.real.ravel(), x.imag.ravel(), 0 * x.real.ravel()], 1)
    k = np.arange(x.size).reshape(x.shape)
    a, b, c, d = k[:-1], k[1:], np.roll(k[1:], -1, 1), np.roll(k[:-1], -1, 1)
    faces = np.concatenate(
        [np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    )
    p, q = vertices[k[8, 0]], vertices[k[8, 45]]
    found = mr.geodesic(meshed(vertices, faces), p, q)
    assert found.converged
    exact = taut_string(vertices[:96], p, q)
    assert float(found.length) == pytest.approx(exact, rel=2e-4)
    smooth = 2 * np.sqrt(0.75) + 0.5 * (angle[45] - 2 * np.arccos(0.5))
    assert float(found.length) == pytest.approx(smooth, rel=2e-3)


def sphere_without_cap(around, subdivisions=4):
    mesh = trimesh.creation.icosphere(subdivisions)
    centre = (
        mesh.triangles_center / np.linalg.norm(mesh.triangles_center, axis=1)[:, None]
    )
    vertices = np.array(mesh.vertices)
    faces = mesh.faces[centre[:, 2] < np.cos(around)]
    rim = np.unique(edges_in_one(faces))
    flat = vertices[rim, :2] / np.linalg.norm(vertices[rim, :2], axis=1)[:, None]
    vertices[rim] = np.c_[np.sin(around) * flat, np.full(len(rim), np.cos(around))]
    return meshed(vertices, faces)


def test_round_the_cap_of_a_sphere():
    """Great circles that touch the rim, and an arc of it."""
    around, colatitude, turn = np.deg2rad(40), np.deg2rad(50), np.pi - 0.3
    place = lambda phi: np.array(
        [
            np.sin(colatitude) * np.cos(phi),
            np.sin(colatitude) * np.sin(phi),
            np.cos(colatitude),
        ]
    )
    found = mr.geodesic(sphere_without_cap(around), place(0.0), place(turn))
    assert found.converged
    touch = np.arccos(np.cos(colatitude) / np.cos(around))
    turned = np.arccos(np.tan(around) / np.tan(colatitude))
    exact = 2 * touch + np.sin(around) * (turn - 2 * turned)
    assert float(found.length) == pytest.approx(exact, rel=5e-4)
    np.testing.assert_allclose(np.linalg.norm(found.points, axis=1), 1, atol=1e-3)


def test_without_walls_nothing_changes():
    p, q = mr.Sphere(2).random_points(jax.random.key(0), 16).reshape(2, 8, 3)
    found = mr.geodesic(meshed(*_whole_sphere()), p, q)
    assert np.all(found.converged)
    np.testing.assert_allclose(found.length, np.arccos(np.sum(p * q, 1)), rtol=1e-5)


def _whole_sphere():
    mesh = trimesh.creation.icosphere(4)
    return np.array(mesh.vertices), mesh.faces


def test_random_points_of_a_sphere_have_no_walls():
    points = np.random.default_rng(0).normal(size=(5000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    found = facets(mr.PointCloud(points, points))
    assert not len(found.walls)
    # Delaunay: 2 V - 4, and a few more where neighbours differ
    assert 0 <= len(found.triangles) - (2 * 5000 - 4) < 0.02 * 10000


def test_ends_on_and_beyond_the_rim():
    vertices, faces = sheet(slit)
    cloud = meshed(vertices, faces)
    corner = np.array([0.4, 0.1, 0.0])
    beyond = np.array([0.452, 0.1, 0.0])  # the rim is at .45
    found = mr.geodesic(cloud, np.stack([corner, corner]), np.stack([beyond, corner]))
    assert np.all(found.converged)
    np.testing.assert_allclose(found.length, [0.05, 0.0], atol=1e-9)
    across = mr.geodesic(cloud, beyond, np.array([0.55, 0.1, 0.0]))
    assert float(across.length) == pytest.approx(1.5, rel=1e-4)
