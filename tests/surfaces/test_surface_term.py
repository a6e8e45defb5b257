"""The linear space of maps beside autodiff, and `register(surface=True)` beside maps that
are known everywhere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import manireg as mr
from manireg._objective.make_problem import make_problem
from manireg._objective.objective import objective
from manireg._objective.sites import Stage
from manireg._selection.folds import training_sets
from manireg._solver.evaluation import evaluate
from manireg._surfaces.linear_map import linear_map
from manireg._surfaces.surface_rounds import radius_of_gyration

BALL = trimesh.creation.icosphere(subdivisions=3)


def bumps(p):
    """A ball with ridges and hollows, its radii from .6 to 1.4."""
    r = 1 + 0.2 * np.sin(4 * p[:, :1] + 1) * np.cos(4 * p[:, 1:2])
    return p * (r + 0.15 * np.cos(5 * p[:, 2:] + p[:, :1]))


def bend(p):
    wave = np.sin(2 * p[:, [1, 2, 0]]) + 0.7 * np.sin(4 * p[:, [2, 0, 1]])
    return p * [1.0, 1.2, 0.8] + 0.1 * wave


def turned(mesh):
    """The vertices of a ball elsewhere on it."""
    turn = trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, 3.0])
    return trimesh.transform_points(mesh.vertices, turn)


@pytest.fixture(scope="module")
def space():
    cloud = mr.PointCloud.from_mesh(BALL)
    x = np.asarray(cloud.points)
    problem = make_problem(
        mr.Ambient(cloud), mr.Euclidean(3), x, bend(x), centres=40, degree=1
    )
    return problem, linear_map(problem), x


def test_values_derivatives_and_bending(space):
    problem, linear, x = space
    w = np.random.default_rng(0).normal(size=(problem.pattern.size, 3))
    psi = lambda p: evaluate(problem.basis, jnp.asarray(w), p, problem.origin)[0]
    np.testing.assert_allclose(linear.at_data(w), psi(jnp.asarray(x)), atol=1e-10)
    jacobians = jax.vmap(jax.jacfwd(lambda p: psi(p[None])[0]))(jnp.asarray(x[:20]))
    found = np.stack([(along @ w)[:20] for along in linear.derivatives], axis=2)
    np.testing.assert_allclose(found, jacobians, atol=1e-8)
    stage = Stage(problem, 1.0, 0.0, problem.energy)
    _, energies = objective(jnp.asarray(w), stage)
    bending = np.sum(w * (linear.bending @ w))
    np.testing.assert_allclose(bending, energies.energy, rtol=1e-9)


def test_fit_is_where_the_gradient_vanishes(space):
    problem, linear, x = space
    rng = np.random.default_rng(1)
    weights = rng.uniform(size=len(x)) / len(x)
    before = rng.normal(size=(problem.pattern.size, 3))
    w = linear.fitted(bend(x), weights, 1e-3, 1e-2, before)
    residual = weights[:, None] * (linear.at_data(w) - bend(x))
    gradient = linear.values.T @ residual + linear.bending @ (
        1e-3 * w + 1e-2 * (w - before)
    )
    # the ridge is left out
    scale = np.max(np.abs(linear.bending @ (1e-2 * before)))
    assert np.max(np.abs(gradient)) < 1e-4 * scale


def test_normals_of_an_affine_map(space):
    problem, linear, x = space
    matrix = np.array([[1.0, 0.4, 0.0], [0.0, 0.7, -0.2], [0.3, 0.0, 1.3]])
    w = linear.fitted(x @ matrix.T, np.full(len(x), 1 / len(x)), 1e-8)
    expected = x @ np.linalg.inv(matrix)  # normals of a ball are its points
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(linear.normals(w, x), expected, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1.0, 1e3])
def test_whole_surface_beats_landmarks(unit):
    """Onto a bent ball with bumps, sampled at other vertices."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    p, q = np.asarray(ball.vertices), turned(ball)
    source = trimesh.Trimesh(unit * bumps(p), ball.faces, process=False)
    target = trimesh.Trimesh(unit * bend(bumps(q)), ball.faces, process=False)
    truth = unit * bend(bumps(p))
    places = np.arange(6)  # corners of the icosahedron
    error = {}
    for surface in (False, True):
        lam = None if surface else 1e-3 * unit**2
        found = mr.register(
            source, target, places, truth[places], lam, centres=200, surface=surface,
            progress=False,
        )  # fmt: skip
        error[surface] = np.linalg.norm(found.vertices - truth, axis=1).mean() / unit
    assert error[True] < 0.92 * error[False]
    assert error[True] < 0.057
    weights = found.match_weights
    assert weights is not None and weights.shape == (len(p),)
    assert np.mean(weights) > 0.9
    fine = trimesh.Trimesh(truth, ball.faces, process=False).face_normals
    assert np.all(np.sum(found.mesh().face_normals * fine, axis=1) > 0)
    again = mr.register(
        source, target, places, truth[places], centres=200, surface=True, progress=False
    )
    np.testing.assert_array_equal(again.vertices, found.vertices)


@pytest.mark.slow
def test_what_goes_on_beyond_the_edge():
    """A cap onto a smaller one: what lies beyond has no match, the rest is right, and a
    larger target does not stretch the source."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    vertices = bumps(np.asarray(ball.vertices))
    z = ball.triangles_center[:, 2]

    def cap(least):
        mesh = trimesh.Trimesh(vertices, ball.faces, process=False)
        mesh.update_faces(z > least)
        mesh.remove_unreferenced_vertices()
        return mesh

    large, small = cap(-0.4), cap(0.0)
    places = np.asarray(small.vertices)[::40]
    found = mr.register(large, small, places, places, surface=True, progress=False)
    weights, height = found.match_weights, np.asarray(large.vertices)[:, 2]
    assert weights is not None
    inside, far = height > 0.2, height < -0.25
    gap = np.linalg.norm(found.vertices - large.vertices, axis=1)
    assert np.mean(gap[inside]) < 0.01
    assert np.mean(weights[inside]) > 0.9 > 0.3 > np.mean(weights[far])
    back = mr.register(small, large, places, places, surface=True, progress=False)
    gap = np.linalg.norm(back.vertices - small.vertices, axis=1)
    assert np.mean(gap) < 0.01 and np.max(gap) < 0.05


@pytest.mark.slow
def test_auto_keeps_what_predicts_landmarks_left_out():
    """Errors are those of registrations without these landmarks; the better is kept."""
    p = np.asarray(BALL.vertices)
    source = trimesh.Trimesh(bumps(p), BALL.faces, process=False)
    truth = bend(bumps(p))
    target = trimesh.Trimesh(truth, BALL.faces, process=False)
    places = np.arange(10)
    options = {"lam": 1e-3, "centres": 60, "progress": False}
    found = mr.register(
        source, target, places, truth[places], surface="auto", **options
    )
    tried = found.held_out
    assert tried is not None
    inside = training_sets(np.ones(10), 5, None)[0]
    for surface, errors in ((False, tried.landmarks), (True, tried.surface)):
        kept = places[inside]
        without = mr.register(
            source, target, kept, truth[kept], surface=surface, **options
        )
        out = places[~inside]
        expected = np.linalg.norm(without.vertices[out] - truth[out], axis=1)
        np.testing.assert_allclose(errors[~inside], expected, rtol=1e-6)
    better = np.mean(tried.surface) < np.mean(tried.landmarks)
    assert tried.surface_is_better == better
    assert (found.match_weights is not None) == better
    with pytest.raises(ValueError, match="needs 8 of them, found 6"):
        mr.register(source, target, places[:6], truth[:6], surface="auto")
    with pytest.raises(ValueError, match="'auto', found 'all'"):
        mr.register(source, target, places, truth[places], surface="all")


def test_scale_of_rounds_is_that_of_the_shape():
    """Bone has an inside: of a ball and of a thin shell, in any unit and position, the
    scale is the radius, not the root of the area."""
    turn = trimesh.transformations.rotation_matrix(
        0.7, [1.0, 2.0, 3.0], [9.0, 0.0, 0.0]
    )
    for inner in ([], [0.97]):
        shells = [trimesh.creation.icosphere(4, radius=r) for r in (1.0, *inner)]
        mesh = trimesh.util.concatenate(shells).apply_scale(40).apply_transform(turn)
        cloud = mr.PointCloud.from_mesh(mesh)
        areas = np.asarray(cloud.areas)
        radius = radius_of_gyration(np.asarray(cloud.points), areas / areas.sum())
        assert radius == pytest.approx(40, rel=0.02)
