"""Subsets of point sets, and what they make of a source."""

import numpy as np
import pytest
from clouds import sphere_cloud

import manireg as mr
from manireg._discretisation.domain import centres_of, discretise
from manireg._discretisation.spacing import (
    data_spacings,
    farthest_indices,
    local_spacings,
)


def test_farthest_points_of_a_line():
    line = np.linspace(0, 1, 101)[:, None]
    assert sorted(farthest_indices(line, 5)) == [0, 25, 50, 75, 100]
    assert farthest_indices(line, 3, first=[50, 50])[0] == 50


def test_spacing_follows_what_is_asked():
    """A third of the spacing, nine times as many."""
    square = np.random.default_rng(0).random((20_000, 2))
    left = square[:, 0] < 0.5
    chosen = farthest_indices(square, 400, spacing=np.where(left, 1.0, 3.0))
    dense = np.sum(left[chosen])
    assert 6 < dense / (400 - dense) < 12


def test_local_spacing_of_a_square_grid():
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    inside = np.all((points[:, :2] > 3) & (points[:, :2] < 16), axis=1)
    assert np.allclose(local_spacings(0.1 * points, 2)[inside], 0.1, rtol=0.15)


def test_spacings_of_data():
    data = np.array([[0.0, 0, 0], [2.0, 0, 0], [2.0, 0, 0]])
    points = np.array([[0.0, 0, 0], [0.0, 6, 0]])
    assert np.allclose(data_spacings(points, data), [2, 8])


def test_graded_domain_is_dense_near_data():
    cloud, data = sphere_cloud(2000), np.array([[0, 0, 1.0], [0, 0.3, 0.954]])
    graded, plain = (centres_of(cloud, 60, data, g) for g in (True, False))
    near = lambda d: np.sum(np.asarray(d.points)[:, 2] > 0.8)
    assert near(graded) > 2 * near(plain)
    weights = discretise(cloud, 60, data, True).weights
    assert np.isclose(np.sum(weights), np.sum(cloud.areas))


def test_graded_is_for_point_clouds():
    interval = mr.Interval(0.0, 1.0)
    x, y = np.linspace(0, 1, 5), np.eye(3)[[0, 1, 2, 0, 1]]
    with pytest.raises(ValueError, match="graded"):
        mr.make_problem(interval, mr.Sphere(2), x, y, graded=True)


def test_a_known_growth_changes_nothing():
    square = np.random.default_rng(0).random((3000, 2))
    spacing = 0.01 + 0.3 * np.linalg.norm(square, axis=1)
    slow = farthest_indices(square, 200, spacing=spacing)
    assert np.array_equal(farthest_indices(square, 200, (), spacing, 0.3), slow)
