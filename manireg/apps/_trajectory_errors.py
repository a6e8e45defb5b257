"""How far a trajectory is from a reference: the errors that SLAM is judged by (Sturm et
al. 2012; Zhang and Scaramuzza 2018)."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from .._surfaces.procrustes import rotations as closest_rotations

NEAR = (
    0.01  # seconds between a pose and that of the reference which it is compared with
)


class TrajectoryErrors(NamedTuple):
    """Root mean squares; degrees, the rest in the unit of positions (NaN without)."""

    poses: int
    """Of poses compared."""
    ate: float
    """Absolute error of position after alignment."""
    ate_degrees: float
    """Of orientation, aligned by the same rotation."""
    rpe: float
    """Relative error of position: of the way over `delta` seconds, in axes of the body."""
    rpe_degrees: float
    """Of the turn in that time."""
    delta: float


def trajectory_errors(
    times: Float[np.ndarray, " k"],
    positions: Float[np.ndarray, "k 3"] | None,
    rotations: Rotation,
    reference_positions: Float[np.ndarray, "k 3"] | None,
    reference_rotations: Rotation,
    delta: float = 1.0,
) -> TrajectoryErrors:
    r"""Of poses $P_i$ against a reference $Q_i$ at the same times, ascending seconds.

    - ATE: $\sqrt{\frac1k \sum_i |q_i - (S p_i + s)|^2}$, S and s the rotation and shift
      that make it least (Umeyama 1991, without scale); the angle is that of
      $R_{Q_i}^\top S R_{P_i}$. Without positions S is the mean of $R_{Q_i} R_{P_i}^\top$.
    - RPE: of $E_i = (Q_i^{-1} Q_j)^{-1} (P_i^{-1} P_j)$ for all i, with j nearest to
      `delta` seconds later (within a tenth of it), translation and angle.

    evo's `evo_ape -a` and `evo_rpe --all_pairs` have the same definitions, theirs over a
    number of frames."""
    k = len(times)
    if k < 3:
        raise ValueError(
            f"reference: {k} of its times are within {NEAR} s of poses; 3 are needed. Are "
            "both in the same clock?"
        )
    turn = Rotation.concatenate([reference_rotations * rotations.inv()]).mean()
    ate = rpe = np.nan
    if positions is not None and reference_positions is not None:
        p = positions - positions.mean(axis=0)
        q = reference_positions - reference_positions.mean(axis=0)
        turn = Rotation.from_matrix(closest_rotations(p[None], q)[0].T)
        ate = _rms(np.linalg.norm(q - turn.apply(p), axis=1))
    angles = (reference_rotations.inv() * turn * rotations).magnitude()
    i, j = _pairs(times, delta)
    of = rotations[i].inv() * rotations[j]
    true = reference_rotations[i].inv() * reference_rotations[j]
    if positions is not None and reference_positions is not None:
        way = rotations[i].inv().apply(positions[j] - positions[i])
        there = reference_positions[j] - reference_positions[i]
        rpe = _rms(
            np.linalg.norm(way - reference_rotations[i].inv().apply(there), axis=1)
        )
    turned = _rms(np.degrees((true.inv() * of).magnitude()))
    return TrajectoryErrors(k, ate, _rms(np.degrees(angles)), rpe, turned, delta)


def associated(
    times: Float[np.ndarray, " k"], reference: Float[np.ndarray, " r"]
) -> tuple[np.ndarray, np.ndarray]:
    """Indices of poses and of those of the reference nearest to them, each once, not more
    than 0.01 s apart; in the order of time."""
    order = np.argsort(times, kind="stable")
    place = np.clip(np.searchsorted(times[order], reference), 1, len(times) - 1)
    left, right = order[place - 1], order[place]
    near = np.abs(reference - times[left]) <= np.abs(reference - times[right])
    nearest = np.where(near, left, right)
    gap = np.abs(times[nearest] - reference)
    best = np.lexsort((gap, nearest))
    best = best[gap[best] <= NEAR]
    _, once = np.unique(nearest[best], return_index=True)
    kept = best[once]
    kept = kept[np.argsort(reference[kept], kind="stable")]
    return nearest[kept], kept


def _pairs(times: np.ndarray, delta: float) -> tuple[Any, Any]:
    later = times + delta
    j = np.clip(np.searchsorted(times, later), 1, len(times) - 1)
    j = np.where(later - times[j - 1] < times[j] - later, j - 1, j)
    i = np.flatnonzero(np.abs(times[j] - later) <= 0.1 * delta)
    if not len(i):
        raise ValueError(
            f"delta: no two poses are {delta:g} s apart; the whole is "
            f"{times[-1] - times[0]:.3g} s long."
        )
    return i, j[i]


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
