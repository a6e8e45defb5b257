"""Scaled products and poses against scipy, finite differences and simulation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import manireg as mr
from manireg._discretisation.domain import discretise

SPACE = mr.SpecialEuclidean(3, length=0.4)
RNG = np.random.default_rng(0)
TURNS = Rotation.from_quat(np.random.default_rng(1).normal(size=(6, 4)))
PLACES = RNG.normal(size=(6, 3))


def points():
    return SPACE.from_pose(PLACES, TURNS.as_quat(), order="xyzw")


def test_distance_is_the_angle_and_the_way_over_the_length():
    p, q = points()[:3], points()[3:]
    angle = (TURNS[:3].inv() * TURNS[3:]).magnitude()
    way = np.linalg.norm(PLACES[:3] - PLACES[3:], axis=1)
    expected = angle**2 + (way / 0.4) ** 2
    np.testing.assert_allclose(SPACE.squared_distance(p, q), expected, rtol=1e-12)
    np.testing.assert_allclose(jnp.sum(SPACE.log(p, q) ** 2, -1), expected, rtol=1e-12)


def test_poses_in_and_out():
    p = points()
    q = TURNS.as_quat(scalar_first=True)
    signs = np.array([1, -1, 1, -1, -1, 1])[:, None]
    np.testing.assert_allclose(SPACE.from_pose(PLACES, signs * q, order="wxyz"), p)
    np.testing.assert_allclose(SPACE.from_pose(PLACES, TURNS, order="wxyz"), p)
    rounded = np.round(q, 4)
    assert np.max(np.abs(SPACE.from_pose(PLACES, rounded, order="wxyz") - p)) < 2e-4
    matrices = SPACE.to_matrices(p)
    np.testing.assert_allclose(matrices[:, :3, :3], TURNS.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(matrices[:, :3, 3], PLACES, atol=1e-15)
    np.testing.assert_allclose(SPACE.from_matrices(matrices), p, atol=1e-15)
    np.testing.assert_allclose(SPACE.from_matrices(matrices[:, :3]), p, atol=1e-15)
    positions, back = SPACE.to_pose(p, order="xyzw")
    np.testing.assert_allclose(positions, PLACES, atol=1e-15)
    assert (Rotation.from_quat(back).inv() * TURNS).magnitude().max() < 1e-7
    assert np.all(np.sum(back[1:] * back[:-1], axis=1) >= 0)
    one = SPACE.to_pose(p[0], order="wxyz")[1]
    assert abs(one @ q[0]) == pytest.approx(1)


def test_reach_and_radius_of_a_scaled_product():
    product = mr.Product(mr.Sphere(2), mr.Sphere(1), scales=(0.5, 3.0))
    assert product.reach == 0.5
    assert product.injectivity_radius == pytest.approx(0.5 * np.pi)
    p, q = product.random_points(jax.random.key(0), 2)
    by_factor = [
        s**2 * f.squared_distance(a, b)
        for s, f, a, b in zip(
            (0.5, 3.0), product.factors, product.split(p), product.split(q)
        )
    ]
    np.testing.assert_allclose(product.squared_distance(p, q), sum(by_factor))


def test_a_scaled_product_as_a_source():
    """Volume s_1^2 4 pi times s_2 L, and the energy of z t in these lengths."""
    s, r = 0.5, 3.0
    source = mr.Product(mr.Sphere(2), mr.Euclidean(1), scales=(s, r))
    ends = np.array([[s, 0, 0, 0.0], [0, s, 0, r]])
    domain = discretise(source, 144, ends)
    np.testing.assert_allclose(np.sum(domain.weights), 4 * np.pi * s**2 * r, rtol=1e-6)
    flat = source.to_ambient(source.project(domain.points))
    np.testing.assert_allclose(flat, domain.points, atol=1e-12)
    energy = mr.eells_energy(
        source, mr.Euclidean(1), lambda p: (p[2] * p[3])[None], domain
    )
    # of the function s r z t: |Hess|^2 = 2 z^2 t^2 / s^4 + 2 (1 - z^2) / (s r)^2
    square = (s * r) ** 2
    inner = 2 / 3 / 3 / s**4 + 2 * 2 / 3 / (s * r) ** 2
    expected = 4 * np.pi * s**2 * r * square * inner
    np.testing.assert_allclose(energy, expected, rtol=2e-3)


def test_following_centres_keep_to_a_scaled_source():
    source = mr.Product(mr.Sphere(1), mr.Euclidean(1), scales=(2.0, 0.1))
    atlas = source.atlas(np.array([[2.0, 0, 0], [0, 2.0, 0.1]]))
    assert atlas is not None
    at = atlas.embed(jnp.array([0.3, 0.7]), jnp.asarray(atlas.labels[0]))
    np.testing.assert_allclose(jnp.hypot(*at[:2]), 2.0)
    np.testing.assert_allclose(at[2], 0.07)


def test_scales_are_leaves_and_none_changes_nothing():
    plain = mr.Product(mr.Sphere(2), mr.Euclidean(1))
    ones = mr.Product(mr.Sphere(2), mr.Euclidean(1), scales=(1.0, 1.0))
    p, q = plain.random_points(jax.random.key(3), 2)
    assert plain.squared_distance(p, q) == ones.squared_distance(p, q)
    assert len(jax.tree.leaves(ones)) == len(jax.tree.leaves(plain)) + 1

    def squared(scale):
        product = mr.Product(mr.Sphere(2), mr.Euclidean(1), scales=(1.0, scale))
        return product.squared_distance(
            product.join(*plain.split(p)), product.join(*plain.split(q))
        )

    slope = jax.grad(squared)(2.0)
    np.testing.assert_allclose(slope, 4 * (p[3] - q[3]) ** 2, rtol=1e-12)


@pytest.mark.parametrize("axes", ["body", "space"])
def test_frames_are_turns_and_moves(axes):
    """exp along the columns of a frame against scipy."""
    p, h = points(), 0.3
    frames = SPACE.frames(p, axes)
    eye = np.swapaxes(frames, 1, 2) @ frames
    np.testing.assert_allclose(eye, np.broadcast_to(np.eye(6), eye.shape), atol=1e-14)
    for j in range(6):
        positions, q = SPACE.to_pose(
            SPACE.exp(p, h * jnp.asarray(frames[:, :, j])), order="xyzw"
        )
        step = h * np.eye(6)[j]
        turn, move = Rotation.from_rotvec(step[:3]), 0.4 * step[3:]
        body = axes == "body"
        expected = TURNS * turn if body else turn * TURNS
        there = PLACES + (TURNS.apply(move) if body else move)
        assert (Rotation.from_quat(q).inv() * expected).magnitude().max() < 1e-7
        np.testing.assert_allclose(positions, there, atol=1e-12)


@pytest.mark.parametrize("axes", ["body", "space"])
def test_covariances_of_simulated_poses(axes):
    """Drawn in rotation vector and position: the covariance of the logarithms."""
    a = RNG.normal(size=(6, 6)) * np.repeat([0.02, 0.01], 3)[:, None]
    covariance = a @ a.T
    p = points()[:1]
    draws = RNG.multivariate_normal(np.zeros(6), covariance, size=20_000)
    turn, move = Rotation.from_rotvec(draws[:, :3]), draws[:, 3:]
    body = axes == "body"
    turned = TURNS[0] * turn if body else turn * TURNS[0]
    there = PLACES[0] + (TURNS[0].apply(move) if body else move)
    y = SPACE.from_pose(there, turned, order="wxyz")
    logs = np.asarray(SPACE.log(p, y))
    noise = SPACE.noise_of(p, covariance, axes=axes)
    coordinates = logs @ noise["frames"][0]
    found = np.linalg.inv(noise["precision"][0])
    scale = np.sqrt(np.diag(found))
    gap = (np.cov(coordinates.T) - found) / np.outer(scale, scale)
    assert np.max(np.abs(gap)) < 0.05
    back = SPACE.covariances_of(p, found[None], noise["frames"], axes=axes)
    np.testing.assert_allclose(back[0], covariance, atol=1e-12)
    # in another frame of the same space
    other = SPACE.frames(p, "space" if body else "body")
    mixed = np.swapaxes(other, 1, 2) @ noise["frames"]
    moved = mixed @ found @ np.swapaxes(mixed, 1, 2)
    back = SPACE.covariances_of(p, moved, other, axes=axes)
    np.testing.assert_allclose(back[0], covariance, atol=1e-12)


def steady(t, w=np.array([0.3, -0.5, 0.8]), v=np.array([1.0, 0.2, -0.4])):
    turn = Rotation.from_rotvec(np.outer(t, w)) * TURNS[0]
    return np.outer(t, v) + PLACES[0], turn, w, v


@pytest.mark.slow
def test_a_fit_with_covariances_and_its_twists():
    """A steady turn and move are a geodesic: both velocities as they are."""
    t = np.linspace(0, 2, 25)
    places, turns, w, v = steady(t)
    y = SPACE.from_pose(places, turns, order="wxyz")
    covariance = np.diag([1, 2, 3, 4, 5, 6]) * 1e-6
    noise = SPACE.noise_of(y, covariance, axes="body")
    model = mr.fit(mr.Interval(0, 2), SPACE, t, y, 1e3, **noise, scatter="none")
    posterior, at = model.posterior("known"), np.array([0.3, 1.0, 1.7])
    places, turns, *_ = steady(at)
    found, q = SPACE.to_pose(model(at), order="xyzw")
    np.testing.assert_allclose(found, places, atol=1e-6)
    assert (Rotation.from_quat(q).inv() * turns).magnitude().max() < 1e-6
    twist = posterior.twist(at)
    np.testing.assert_allclose(twist.value, np.tile([*w, *v], (3, 1)), atol=1e-5)
    body = posterior.twist(at, "body").value
    np.testing.assert_allclose(body[:, :3], turns.inv().apply(w), atol=1e-5)
    np.testing.assert_allclose(body[:, 3:], turns.inv().apply(v), atol=1e-5)
    turning = posterior.angular_velocity(at)
    np.testing.assert_allclose(turning.value, twist.value[:, :3], atol=1e-12)
    np.testing.assert_allclose(
        turning.covariance, twist.covariance[:, :3, :3], rtol=1e-6
    )
    own = posterior.reading(at, lambda p, v: 0.4 * v[9:])
    np.testing.assert_allclose(own.value, twist.value[:, 3:], atol=1e-12)
    np.testing.assert_allclose(own.covariance, twist.covariance[:, 3:, 3:], rtol=1e-6)
    # of the geodesic least squares with these weights: the middle is known best
    covariances = SPACE.covariances_of(
        model(at), *posterior.covariance(at), axes="body"
    )
    spread = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    assert np.all(spread[1] < spread[0]) and np.all(spread[1] < spread[2])
    ratio = (spread[1] / np.sqrt(np.diag(covariance))) ** 2 * len(t)
    # the axes of the body turn by two radians, which mixes the variances a little
    np.testing.assert_allclose(ratio, 1.0, atol=0.2)


def test_errors():
    with pytest.raises(ValueError, match="`n` must be 3"):
        mr.SpecialEuclidean(2)
    with pytest.raises(ValueError, match="`length` must be positive"):
        mr.SpecialEuclidean(3, length=0.0)
    with pytest.raises(ValueError, match="one number a factor"):
        mr.Product(mr.Sphere(2), mr.Euclidean(1), scales=(1.0,))
    with pytest.raises(ValueError, match="must be positive"):
        mr.Product(mr.Sphere(2), scales=(np.nan,))
    q = TURNS.as_quat()
    with pytest.raises(ValueError, match="order: expected"):
        SPACE.from_pose(PLACES, q, order="zyxw")
    with pytest.raises(ValueError, match="1 of 6 have a length other than 1.*index 2"):
        bad = q.copy()
        bad[2] *= 1.01
        SPACE.from_pose(PLACES, bad, order="xyzw")
    matrices = SPACE.to_matrices(points())
    with pytest.raises(ValueError, match="Transpose"):
        SPACE.from_matrices(np.swapaxes(matrices, 1, 2))
    with pytest.raises(ValueError, match="no rotation"):
        SPACE.from_matrices(matrices * np.array([-1, 1, 1, 1]))
    with pytest.raises(ValueError, match="not positive definite"):
        SPACE.noise_of(points(), np.diag([1, 1, 1, 1, 1, 0.0]), axes="body")
    with pytest.raises(ValueError, match="not symmetric"):
        SPACE.noise_of(points(), np.triu(np.ones((6, 6))), axes="body")
    with pytest.raises(ValueError, match='"space" or "body"'):
        SPACE.noise_of(points(), np.eye(6), axes="ros")
    with pytest.raises(ValueError, match="points lie off rotations"):
        bad = np.array(points())
        bad[:, :9] *= 1.1
        mr.make_problem(mr.Interval(0, 1), SPACE, np.linspace(0, 1, 6), bad)
