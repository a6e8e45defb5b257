"""ATE and RPE by hand."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from manireg.apps._trajectory_errors import associated, trajectory_errors

RNG = np.random.default_rng(2)
TIMES = 0.1 * np.arange(40)
TURNS = Rotation.from_rotvec(np.outer(TIMES, [0.2, 0.5, -0.3]))
PLACES = np.stack([np.cos(TIMES), np.sin(2 * TIMES), 0.3 * TIMES], axis=1)
NOISY = PLACES + 0.05 * RNG.normal(size=PLACES.shape)
NOISY_TURNS = TURNS * Rotation.from_rotvec(0.02 * RNG.normal(size=(40, 3)))


def test_moved_and_turned_as_a_whole_is_no_error():
    turn, move = Rotation.from_rotvec([1.0, -0.4, 0.7]), [3.0, 1.0, -2.0]
    found = trajectory_errors(
        TIMES, turn.apply(PLACES) + move, turn * TURNS, PLACES, TURNS, 0.5
    )
    assert found.poses == 40
    np.testing.assert_allclose(found[1:5], 0, atol=1e-6)


def test_ate_is_the_least():
    found = trajectory_errors(TIMES, NOISY, NOISY_TURNS, PLACES, TURNS)

    def rms(z):
        moved = Rotation.from_rotvec(z[:3]).apply(NOISY) + z[3:]
        return np.sqrt(np.mean(np.sum((moved - PLACES) ** 2, axis=1)))

    best = minimize(rms, np.zeros(6), method="BFGS", options={"gtol": 1e-10})
    assert found.ate == pytest.approx(best.fun, rel=1e-7)
    turn = Rotation.from_rotvec(best.x[:3])
    angles = np.degrees((TURNS.inv() * turn * NOISY_TURNS).magnitude())
    assert found.ate_degrees == pytest.approx(np.sqrt(np.mean(angles**2)), rel=1e-4)


def test_rpe_with_matrices():
    """E = (Q_i^-1 Q_j)^-1 (P_i^-1 P_j) of 4 x 4 matrices, half a second apart."""

    def matrices(p, r):
        found = np.tile(np.eye(4), (len(p), 1, 1))
        found[:, :3, :3], found[:, :3, 3] = r.as_matrix(), p
        return found

    p, q = matrices(NOISY, NOISY_TURNS), matrices(PLACES, TURNS)
    inv = np.linalg.inv
    e = inv(inv(q[:-5]) @ q[5:]) @ (inv(p[:-5]) @ p[5:])
    move = np.sqrt(np.mean(np.sum(e[:, :3, 3] ** 2, axis=1)))
    angle = np.degrees(Rotation.from_matrix(e[:, :3, :3]).magnitude())
    found = trajectory_errors(TIMES, NOISY, NOISY_TURNS, PLACES, TURNS, 0.5)
    assert found.rpe == pytest.approx(move, rel=1e-10)
    assert found.rpe_degrees == pytest.approx(np.sqrt(np.mean(angle**2)), rel=1e-6)


def test_orientations_alone():
    turn = Rotation.from_rotvec([0.5, 0, 1.0])
    found = trajectory_errors(TIMES, None, turn * NOISY_TURNS, None, TURNS)
    assert np.isnan(found.ate) and np.isnan(found.rpe)
    assert 1.0 < found.ate_degrees < 3.0


def test_association_takes_the_nearest_once():
    i, j = associated(np.array([0.3, 0.1, 0.2]), np.array([0.101, 0.104, 0.25, 0.3]))
    np.testing.assert_array_equal(i, [1, 0])
    np.testing.assert_array_equal(j, [0, 3])


def test_too_long_a_delta():
    with pytest.raises(ValueError, match="no two poses are 9 s apart"):
        trajectory_errors(TIMES, NOISY, NOISY_TURNS, PLACES, TURNS, 9.0)
