"""Landmarks where two sheets are nearer to each other than their vertices."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import manireg as mr
from manireg._sources.checks import check_landmarks


@pytest.mark.parametrize("thickness", [0.02, 0.05, 0.1])
def test_landmarks_near_a_sharp_rim(thickness):
    """Of a lens: closest points of closest points are elsewhere; landmarks stay where they
    are, on the surface, and nearly as near as a point of the mesh can be."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices = ball.vertices * [1, 1, thickness]
    mesh = trimesh.Trimesh(vertices, ball.faces, process=False)
    lens = mr.PointCloud.from_mesh(mesh)
    rng = np.random.default_rng(0)
    angle, radius = rng.uniform(0, 2 * np.pi, 300), rng.uniform(0.8, 1.02, 300)
    height = rng.uniform(-0.02, 0.02, 300)
    y = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
    project = lambda points: np.asarray(lens.project(jnp.asarray(points)))
    once = project(y)
    again = np.linalg.norm(project(once) - once, axis=1)
    assert np.any(again > 1e-3)
    landed = check_landmarks("landmarks", lens, y)
    np.testing.assert_allclose(project(landed), landed, atol=1e-9)
    apart = np.linalg.norm(landed - y, axis=1)
    to_vertices = np.linalg.norm(y[:, None] - vertices, axis=2).min(axis=1)
    assert np.all(apart < to_vertices + 0.05)
