"""Matches beside brute force."""

import numpy as np
import pytest
import trimesh

from manireg._surfaces.correspondence import (
    NEIGHBOURS,
    OrientedPoints,
    edge_points,
    inlier_weights,
    matches,
)

RNG = np.random.default_rng(3)


def oriented(n, edge=0):
    normals = RNG.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return OrientedPoints(RNG.normal(size=(n, 3)), normals, np.arange(n) < edge)


def by_brute_force(ours, theirs, a):
    """Sums over all pairs, from the definition."""
    d2 = np.sum((ours.points[:, None] - theirs.points) ** 2, axis=2)
    d2 += a**2 * np.sum((ours.normals[:, None] - theirs.normals) ** 2, axis=2)
    affinity = np.zeros(d2.shape)
    for i in range(len(d2)):
        near = np.argsort(d2[i])[:NEIGHBOURS]
        affinity[i, near] += 1 / d2[i, near]
    rim = theirs.points[theirs.on_edge]
    gap = np.linalg.norm(ours.points[:, None] - rim, axis=2).min(axis=1)
    alone = ours.on_edge & (gap > 2 * a)
    assert 0 < np.sum(alone) < np.sum(ours.on_edge)
    for j in range(d2.shape[1]):
        near = np.argsort(d2[:, j])[:NEIGHBOURS]
        if not alone[near[0]]:
            affinity[near, j] += 1 / d2[near, j]
    affinity /= affinity.sum(axis=1, keepdims=True)
    return affinity


def test_matches_are_those_of_brute_force():
    ours, theirs, a = oriented(60, edge=10), oriented(80, edge=20), 0.3
    found, affinity = matches(ours, theirs, a), by_brute_force(ours, theirs, a)
    np.testing.assert_allclose(found.points, affinity @ theirs.points, atol=1e-12)
    beyond = affinity @ theirs.on_edge > 0.5
    assert np.any(beyond) and np.all(found.weights[beyond] == 0)
    assert np.all((found.weights >= 0) & (found.weights <= 1))


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_neither_unit_nor_origin_matters(unit):
    ours, theirs = oriented(60, edge=10), oriented(80, edge=20)
    move = lambda p: unit * (p + 30.0)
    moved = [s._replace(points=move(s.points)) for s in (ours, theirs)]
    once, again = matches(ours, theirs, 0.7), matches(moved[0], moved[1], 0.7 * unit)
    np.testing.assert_allclose(move(once.points), again.points, rtol=1e-9)
    np.testing.assert_allclose(once.weights, again.weights, atol=1e-7)


def test_same_points_match_themselves():
    ours = oriented(50)
    found = matches(ours, ours, 1.0)
    np.testing.assert_allclose(found.points, ours.points, atol=1e-3)
    assert np.all(found.weights > 0.999)


def test_outliers_weigh_nothing():
    """Normal residuals of known deviation with far ones among them."""
    squares = np.sum(RNG.normal(size=(2000, 3)) ** 2, axis=1)
    squares[:30] = 1e3
    weights = inlier_weights(squares, np.ones(2000))
    assert np.all(weights[:30] < 1e-3)
    assert np.mean(weights[30:]) > 0.99
    np.testing.assert_array_equal(inlier_weights(0 * squares, weights), weights)


def test_edge_of_a_cap():
    ball = trimesh.creation.icosphere(subdivisions=3)
    whole = edge_points(np.asarray(ball.faces), len(ball.vertices))
    assert not np.any(whole)
    ball.update_faces(ball.triangles_center[:, 2] > 0)
    ball.remove_unreferenced_vertices()
    edge = edge_points(np.asarray(ball.faces), len(ball.vertices))
    rim = np.unique(np.asarray(ball.outline().entities[0].points))
    np.testing.assert_array_equal(np.flatnonzero(edge), rim)
