"""Smoothed trajectories against motions that are known."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import manireg as mr
from manireg.apps._outliers import outliers
from manireg.apps._signs import lifted
from manireg.apps._stamps import seconds_since

T = np.linspace(0, 4, 81)
RNG = np.random.default_rng(0)
SIGMA = np.radians(0.5), 0.01


def place(t):
    return np.stack([np.cos(t), np.sin(t), 0.2 * t], axis=-1)


def turn(t):
    """About the third axis of space at 1 radian a second, after a tilt that rocks."""
    z = np.zeros_like(t)
    rock = Rotation.from_rotvec(np.stack([0.3 * np.sin(2 * t), z, z], axis=-1))
    return Rotation.from_rotvec(np.stack([z, z, 1.0 * t], axis=-1)) * rock


def measured(t=T):
    rng = np.random.default_rng(1)
    noise = Rotation.from_rotvec(SIGMA[0] * rng.normal(size=(len(t), 3)))
    return place(t) + SIGMA[1] * rng.normal(size=(len(t), 3)), turn(t) * noise


@pytest.fixture(scope="module")
def found():
    p, r = measured()
    return mr.apps.trajectory(T, p, r, order=3, centres=32)


@pytest.mark.slow
def test_poses_and_velocities(found):
    at = np.linspace(0.2, 3.8, 50)
    m: Any = found.at(at)
    gap = np.linalg.norm(m.positions - place(at), axis=1)
    assert gap.mean() < SIGMA[1]  # a datum's is 1.6 of it
    turns = Rotation.from_quat(m.quaternions, scalar_first=True)
    assert (turns.inv() * turn(at)).magnitude().mean() < SIGMA[0]
    h = 1e-5
    velocity = (place(at + h) - place(at - h)) / (2 * h)
    rates = (turn(at - h).inv() * turn(at + h)).as_rotvec() / (2 * h)
    for value, truth, covariance in (
        (m.velocities, velocity, m.velocity_covariances),
        (m.angular_velocities, rates, m.angular_velocity_covariances),
        (m.positions, place(at), m.position_covariances),
    ):
        z = (value - truth)[:, :, None]
        squares = (np.swapaxes(z, 1, 2) @ np.linalg.solve(covariance, z)).ravel()
        assert 1.0 < squares.mean() < 6.0  # 3 expected, of dependent numbers
    for name, sigma in zip(("orientation", "position"), SIGMA):
        assert found.parts[name].sigma == pytest.approx(sigma, rel=0.15)
    assert len(found.outliers) == 0 and found.gaps == []


@pytest.mark.slow
def test_covariances_of_orientations_are_of_the_body(found):
    """Those of posterior draws, by scipy's rotation vectors."""
    import jax

    posterior = found.orientation.posterior
    at = np.array([1.0, 2.0])
    m: Any = found.at(at)
    here = Rotation.from_quat(m.quaternions, scalar_first=True)
    draws = posterior.sample(jax.random.key(0), 400)
    turns = [
        (
            here.inv() * Rotation.from_quat(np.asarray(d(at)), scalar_first=True)
        ).as_rotvec()
        for d in draws
    ]
    for i in range(2):
        drawn = np.cov(np.array(turns)[:, i].T)
        scale = np.sqrt(np.diag(m.orientation_covariances[i]))
        gap = (drawn - m.orientation_covariances[i]) / np.outer(scale, scale)
        assert np.max(np.abs(gap)) < 0.25


@pytest.mark.slow
def test_origin_and_clock_change_nothing(found):
    """UTM coordinates and nanoseconds since 1970."""
    p, r = measured()
    stamps = 1403715524907143168 + np.round(T * 1e9).astype(np.int64)
    far = np.array([4.1e5, 5.3e6, 100.0])
    q = r.as_quat() * np.where(RNG.random(len(T)) < 0.5, -1, 1)[:, None]
    other = mr.apps.trajectory(
        stamps, p + far, q, quaternions="xyzw", unit=1e-9, order=3, centres=32
    )
    a: Any = found.after(T)
    b: Any = other.at(stamps)
    np.testing.assert_allclose(b.positions - far, a.positions, atol=1e-6)
    np.testing.assert_allclose(b.velocities, a.velocities, atol=1e-6)
    np.testing.assert_allclose(b.angular_velocities, a.angular_velocities, atol=1e-6)
    sign = np.sign(np.sum(a.quaternions * b.quaternions, axis=1))[:, None]
    np.testing.assert_allclose(sign * b.quaternions, a.quaternions, atol=1e-6)
    np.testing.assert_allclose(
        b.position_covariances, a.position_covariances, rtol=1e-3, atol=1e-12
    )


def test_integers_are_subtracted_before_they_are_floats():
    first = np.int64(1403715524907143168)
    stamps = first + np.arange(3)
    np.testing.assert_array_equal(
        seconds_since(stamps, first, 1e-9), np.arange(3) * 1e-9
    )
    dates = stamps.astype("M8[ns]")
    np.testing.assert_allclose(seconds_since(dates, dates[0], 1.0), np.arange(3) * 1e-9)


def test_signs_pass_by_outliers():
    """A pose turned by nearly half a turn does not turn the rest over."""
    angle = np.linspace(0, 6 * np.pi, 60)
    q = Rotation.from_rotvec(np.outer(angle, [0, 0, 1.0])).as_quat()
    q[[20, 21, 40]] = Rotation.from_quat(
        np.random.default_rng(3).normal(size=(3, 4))
    ).as_quat()
    random = q * np.where(RNG.random(60) < 0.5, -1, 1)[:, None]
    signed = lifted(np.arange(60.0), random)
    good = np.setdiff1d(np.arange(60), [20, 21, 40])
    expected = np.stack([np.sin(angle / 2), np.cos(angle / 2)], axis=1)[good]
    agree = np.sum(signed[good][:, 2:] * expected, axis=1)
    np.testing.assert_allclose(agree, agree[0], atol=1e-6)
    assert abs(agree[0]) == pytest.approx(1)


def test_outliers_are_those_put_in():
    p, _ = measured()
    bad = np.array([3, 30, 31, 60])
    p[bad] += 0.25 * np.array([[1, 0, 0], [0, 1, 1], [0, -1, 1], [1, 1, 0.0]])
    order = RNG.permutation(len(T))
    found = np.flatnonzero(outliers(T[order], p[order]))
    np.testing.assert_array_equal(np.sort(order[found]), bad)
    assert not outliers(T, measured()[0]).any()
    assert not outliers(T, place(T)).any()
    step = place(T)
    step[40:] += 1.0  # on another path from there on
    assert outliers(T, step).sum() == 0


def test_gaps_are_named():
    keep = (T < 1.5) | (T > 2.6)
    p, _ = measured()
    found: Any = mr.apps.trajectory(T[keep], p[keep], order=3, centres=32)
    (gap,) = found.gaps
    assert gap.start == pytest.approx(1.45) and gap.end == pytest.approx(2.65)
    assert gap.bridged == (1.2 <= found.position.window)
    m: Any = found.after(np.array([1.0, 2.0]))
    assert np.linalg.det(m.position_covariances[1]) > 8 * np.linalg.det(
        m.position_covariances[0]
    )
    assert m.quaternions is None and m.angular_velocities is None


def test_errors():
    with pytest.raises(ValueError, match="positions, orientations or both"):
        mr.apps.trajectory(T)
    with pytest.raises(ValueError, match="where the scalar is"):
        mr.apps.trajectory(T, orientations=turn(T).as_quat())


def test_steps_of_rounding_are_no_outliers():
    still = np.zeros((40, 3))
    still[[7, 21, 30], 0] = 1e-3
    assert not outliers(np.arange(40.0), still).any()
