"""Readings of derivatives: against rotations and motions that are known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import manireg as mr
from manireg.datasets._tables import directions

W = np.array([0.3, -0.8, 1.1])
START = Rotation.from_rotvec([0.4, 0.1, -0.5])


def turned(t):
    return jnp.asarray((Rotation.from_rotvec(t * W) * START).as_matrix())


def cross(w):
    return np.cross(w, np.eye(3)).T


def test_angular_velocity_of_a_steady_turn():
    """R(t) = exp(t [w]) R(0): w in space, R(0)^T w in the body, at any time."""
    r = jnp.stack([turned(t) for t in (0.0, 0.7, 2.0)])
    v = cross(W) @ r
    space, body = (mr.angular_velocity(r, v, axes=a) for a in ("space", "body"))
    np.testing.assert_allclose(space, np.tile(W, (3, 1)), atol=1e-14)
    own = START.as_matrix().T @ W
    np.testing.assert_allclose(body, np.tile(own, (3, 1)), atol=1e-14)
    normal = r @ np.diag([1.0, 2.0, 3.0])  # R times a symmetric matrix
    np.testing.assert_allclose(
        mr.angular_velocity(r, v + normal, "body"), body, atol=1e-14
    )
    # of a difference quotient, and of one rotation
    h = 1e-5
    slope = (turned(h) - turned(-h)) / (2 * h)
    np.testing.assert_allclose(mr.angular_velocity(turned(0.0), slope), W, atol=1e-9)


@pytest.mark.parametrize("radius", [1.0, 6371.0])
def test_motion_around_a_known_pole(radius):
    """v = w times p, on the great circle of the pole: its rate."""
    pole = directions(30.0, 40.0)
    across = np.linalg.svd(pole[None])[2][1:]
    angle = np.linspace(0, 6, 7)
    p = radius * (
        np.outer(np.cos(angle), across[0]) + np.outer(np.sin(angle), across[1])
    )
    motion = mr.sphere_motion(p, np.cross(0.2 * pole, p))
    np.testing.assert_allclose(motion.speed, 0.2, rtol=1e-13)
    np.testing.assert_allclose(motion.euler_pole, np.tile(pole, (7, 1)), atol=1e-13)


def test_azimuths_are_those_of_a_compass():
    """From places of known latitude and longitude towards others close by."""
    lat, lon = np.radians([0.0, 50.0, -33.0]), np.radians([0.0, 120.0, 260.0])
    place = lambda lat, lon: (
        3
        * np.stack(
            [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1
        )
    )
    for bearing in (0.0, 30.0, 90.0, 180.0, 200.0, 270.0, 359.9):
        a, h = np.radians(bearing), 1e-4
        to = lambda h: place(lat + h * np.cos(a), lon + h * np.sin(a) / np.cos(lat))
        motion = mr.sphere_motion(place(lat, lon), (to(h) - to(-h)) / (2 * h))
        gap = (np.asarray(motion.azimuth) - bearing + 180) % 360 - 180
        np.testing.assert_allclose(gap, 0, atol=1e-5)
        np.testing.assert_allclose(motion.speed, 1, rtol=1e-7)
        assert np.all((motion.azimuth >= 0) & (motion.azimuth < 360))


def test_west_of_north_by_rounding_is_north():
    motion = mr.sphere_motion(np.array([1.0, 0, 0]), np.array([0, -1e-20, 1.0]))
    assert 0 <= motion.azimuth < 360


def test_no_motion_has_no_direction():
    p = np.array([[1.0, 0, 0], [0, 0, 1.0]])
    motion = mr.sphere_motion(p, np.array([[0.0, 0, 0], [1.0, 0, 0]]))
    np.testing.assert_array_equal(motion.speed, [0, 1])
    assert np.all(np.isnan(motion.azimuth))  # at the geographic pole, too
    assert np.all(np.isnan(motion.euler_pole[0]))
    np.testing.assert_allclose(motion.euler_pole[1], [0, 1, 0])
    speed = lambda v: mr.sphere_motion(jnp.asarray(p[0]), v).speed
    np.testing.assert_array_equal(jax.grad(speed)(jnp.zeros(3)), 0)
    np.testing.assert_array_equal(jax.jit(jax.vmap(speed))(jnp.eye(3)), [0, 1, 1])


def test_errors():
    r = np.eye(3)
    with pytest.raises(
        ValueError, match='axes: expected "space" or "body", found \'eye\''
    ):
        mr.angular_velocity(r, r, axes="eye")
    with pytest.raises(ValueError, match=r"velocity: expected shape \(..., 3, 3\)"):
        mr.angular_velocity(r, r[0])
    with pytest.raises(ValueError, match=r"v: expected shape \(..., 3\), found \(2,\)"):
        mr.sphere_motion(r[0], r[0, :2])
