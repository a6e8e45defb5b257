"""Surfaces of a dozen points: fits from and to them, or an error that tells the cure."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import manireg as mr

ICOSAHEDRON = trimesh.creation.icosahedron()
V = np.asarray(ICOSAHEDRON.vertices)
W = V * [1.0, 1.2, 0.8]
CORNERS = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
TETRAHEDRON = trimesh.Trimesh(
    CORNERS, [[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], process=False
)
OCTAHEDRON = trimesh.convex.convex_hull(np.concatenate([np.eye(3), -np.eye(3)]))


@pytest.mark.parametrize("mesh", [ICOSAHEDRON, trimesh.creation.box()])
def test_a_dozen_points_are_a_surface(mesh):
    cloud = mr.PointCloud.from_mesh(mesh)
    vertices = jnp.asarray(mesh.vertices)
    np.testing.assert_allclose(cloud.project(vertices), vertices, atol=1e-12)
    assert float(jnp.sum(cloud.areas)) == pytest.approx(mesh.area)
    size = jnp.linalg.norm(vertices, axis=1)
    np.testing.assert_allclose(cloud.signed_distance(1.1 * vertices), 0.1 * size, 1e-6)
    # between faces and the ball around them
    inside, outside = mesh.triangles_center, np.max(size)
    middle = np.linalg.norm(cloud.project(2.0 * jnp.asarray(inside)), axis=1)
    assert np.all(middle > 0.8 * np.linalg.norm(inside, axis=1))
    assert np.all(middle < 1.1 * outside)


@pytest.mark.parametrize("mesh", [TETRAHEDRON, OCTAHEDRON], ids=["4", "6"])
def test_fewer_are_an_error_with_its_cure(mesh):
    found = len(mesh.vertices)
    with pytest.raises(ValueError, match=f"points: {found} are too few .* at least 7"):
        mr.PointCloud.from_mesh(mesh)
    numbers = np.arange(5)  # as many as `register` wants
    with pytest.raises(ValueError, match="too few|vertex 4 does not exist"):
        mr.register(mesh, ICOSAHEDRON, numbers, numbers, 1e-3)
    assert mr.PointCloud.from_mesh(mesh.subdivide()).dim == 2


def test_points_of_a_curve():
    with pytest.raises(ValueError, match="points: 3 are too few .* at least 4"):
        mr.PointCloud(np.eye(3)[:, :2] + 1, np.ones((3, 2)))


def test_function_on_an_icosahedron():
    """Heights of its vertices, at its vertices and in between."""
    cloud = mr.PointCloud.from_mesh(ICOSAHEDRON)
    model = mr.fit(cloud, mr.Euclidean(1), V, V[:, 2:], 1e-6)
    np.testing.assert_allclose(model(V)[:, 0], V[:, 2], atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("geometry", ["ambient", "intrinsic"])
def test_registration_of_icosahedra(geometry):
    target = trimesh.Trimesh(W, ICOSAHEDRON.faces, process=False)
    numbers = np.arange(12)
    found = mr.register(
        ICOSAHEDRON, target, numbers, numbers, 1e-3, geometry=geometry, progress=False
    )
    np.testing.assert_allclose(found.vertices, W, atol=0.05)
