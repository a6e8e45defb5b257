"""What users have of poses - quaternions in two orders, 4 x 4 matrices, 6 x 6
covariances - checked, once, on the host."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ..._input.numbers import Numbers, as_numbers

CLOSE = 1e-3  # of unit quaternions and rotation matrices that were rounded
SYMMETRIC = 1e-8  # of the largest entry of a covariance


def rotations_of(quaternion: Numbers, order: str) -> Float[np.ndarray, "... 3 3"]:
    first = _scalar_first(order)
    if hasattr(quaternion, "as_matrix"):
        return np.asarray(quaternion.as_matrix())
    q = as_numbers("quaternion", quaternion)
    if q.shape[-1:] != (4,):
        raise ValueError(f"quaternion: expected shape (..., 4), found {q.shape}.")
    flat = q.reshape(-1, 4)
    length = np.linalg.norm(flat, axis=1)
    _refuse(
        ~(np.abs(length - 1) <= CLOSE),
        "quaternion",
        lambda i: f"have a length other than 1 (first at index {i}: {length[i]:.4g})",
        "Divide them by it, or look for rows that are missing or shifted.",
    )
    found = Rotation.from_quat(flat, scalar_first=first).as_matrix()
    return found.reshape(*q.shape[:-1], 3, 3)


def quaternions_of(
    rotations: Float[np.ndarray, "*k 3 3"], order: str
) -> Float[np.ndarray, "*k 4"]:
    """Each with the sign that continues the one before along the first axis."""
    first = _scalar_first(order)
    flat = Rotation.from_matrix(rotations.reshape(-1, 3, 3))
    q = flat.as_quat(canonical=True, scalar_first=first)
    q = q.reshape(*rotations.shape[:-2], 4)
    return continued(q) if q.ndim > 1 else q


def continued(q: Float[np.ndarray, "k *b 4"]) -> Float[np.ndarray, "k *b 4"]:
    """The same rotations, with the sign that continues the row before."""
    turns = np.where(np.sum(q[1:] * q[:-1], axis=-1) < 0, -1.0, 1.0)
    signs = np.concatenate([np.ones_like(q[:1, ..., 0]), np.cumprod(turns, axis=0)])
    return q * signs[..., None]


def matrices_of(
    matrices: Numbers,
) -> tuple[Float[np.ndarray, "... 3 3"], Float[np.ndarray, "... 3"]]:
    """Rotations and positions of homogeneous matrices."""
    m = as_numbers("matrices", matrices)
    if m.ndim < 2 or m.shape[-2:] not in ((4, 4), (3, 4)):
        raise ValueError(
            f"matrices: expected shape (..., 4, 4) or (..., 3, 4), found {m.shape}."
        )
    flat = m.reshape(-1, *m.shape[-2:])
    if m.shape[-2] == 4:
        _refuse(
            ~np.all(np.abs(flat[:, 3] - [0, 0, 0, 1]) <= 1e-9, axis=1),
            "matrices",
            lambda i: f"have a last row other than 0, 0, 0, 1 (first at index {i})",
            "Transpose them if the position is in the last row.",
        )
    linear = flat[:, :3, :3]
    good = np.asarray(np.isfinite(linear).all(axis=(1, 2)))
    u, s, vt = np.linalg.svd(np.where(good[:, None, None], linear, 0.0))
    proper = np.asarray(np.linalg.det(u @ vt)) > 0
    good = good & (np.abs(s - 1) <= CLOSE).all(axis=1) & proper
    _refuse(
        np.asarray(~good),
        "matrices",
        lambda i: f"hold no rotation in their first three columns (first at index {i})",
        "Take out scale, shear and reflection, or leave these poses out.",
    )
    batch = m.shape[:-2]
    return (u @ vt).reshape(*batch, 3, 3), m[..., :3, 3]


def check_covariances(given: np.ndarray, k: int) -> Float[np.ndarray, "k 6 6"]:
    """Of k poses; one is for all."""
    if given.shape not in ((6, 6), (k, 6, 6)):
        raise ValueError(
            f"covariances: expected shape (6, 6) or ({k}, 6, 6), found {given.shape}."
        )
    each = given.reshape(-1, 6, 6)
    gap = np.max(np.abs(each - np.swapaxes(each, 1, 2)), axis=(1, 2))
    _refuse(
        ~(gap <= SYMMETRIC * np.max(np.abs(each), axis=(1, 2))),
        "covariances",
        lambda i: f"are not symmetric or not finite (first at index {i})",
        "Rounding: take (C + C^T) / 2.",
    )
    # of correlations: radians and metres have no common size
    deviation = np.sqrt(np.maximum(np.diagonal(each, axis1=1, axis2=2), 0.0))
    size = np.where(deviation > 0, deviation, 1.0)
    least = np.linalg.eigvalsh(each / size[:, :, None] / size[:, None, :])[:, 0]
    _refuse(
        ~(least > 1e-12),
        "covariances",
        lambda i: f"are not positive definite (first at index {i})",
        "Nothing is known exactly: give each direction the least deviation it has. What "
        "is not known at all is a large one.",
    )
    return np.broadcast_to((each + np.swapaxes(each, 1, 2)) / 2, (k, 6, 6))


def _scalar_first(order: str) -> bool:
    if order not in ("wxyz", "xyzw"):
        raise ValueError(
            f'order: expected "wxyz" or "xyzw", found {order!r}: which number of the '
            "quaternion is its scalar, w?"
        )
    return order == "wxyz"


def _refuse(bad: np.ndarray, name: str, what, cure: str):
    if bad.any():
        i = int(np.argmax(bad))
        raise ValueError(f"{name}: {bad.sum()} of {len(bad)} {what(i)}. {cure}")
