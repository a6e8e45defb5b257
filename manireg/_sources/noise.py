"""How precise data are: what is known of each datum's noise, along which axes."""

import math

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from .._input.numbers import Numbers, as_numbers
from .._input.positive import refuse_other_than_positive
from ..manifolds import AbstractManifold
from ..manifolds._defaults.frames import orthonormal_axes, tangent_frames

ALIKE = 1e-6  # frames against orthonormal ones of the tangent space
SYMMETRIC = 1e-8  # of the largest entry of a matrix
NEGATIVE = 1e-10  # likewise, of an eigenvalue that counts as 0
NOTHING = 1e-12  # of the largest entry: below it is rounding
NO_NOISE = (
    "Give data that say nothing the weight 0 in `weights`, and here some other value."
)


class Noise(eqx.Module):
    """Of each datum, in its principal axes: the squared length of a residual r in standard
    deviations is the sum of `precisions * (axes^T r)^2`, or `precisions * |r|^2`."""

    precisions: Float[Array, "k n"] | Float[Array, " k"]
    """Inverse variances, absolute, in units of N^-2. Along axes some may be 0: there
    nothing is known."""
    axes: Float[Array, "k t n"] | None
    """Orthonormal vectors of T_y N, flattened; None: the same precision along all."""


def check_noise(
    target: AbstractManifold,
    y: Float[np.ndarray, "k t"],
    sigma: Numbers | None = None,
    precision: Numbers | None = None,
    frames: Numbers | None = None,
) -> Noise | None:
    """The noise of data `y` that lie on the target (flattened); None if nothing is given.

    - `sigma`: standard deviation per tangent direction, in the unit of the target: one
      number, or `(k,)`.
    - `precision`: inverse covariances, of which the part along the tangent space counts:
      `(k, t, t)`, or in the shape of points, `(k, *point_shape, *point_shape)`; with
      `frames`, in the coordinates these give, `(k, n, n)`.
    - `frames`: orthonormal tangent vectors at y, as columns: `(k, t, n)` or
      `(k, *point_shape, n)`.
    """
    if precision is None:
        if frames is not None:
            raise ValueError(
                "frames: say in which coordinates `precision` is given, which is missing. "
                "Give it, or leave out the frames."
            )
        return None if sigma is None else _isotropic(sigma, len(y))
    if sigma is not None:
        raise ValueError(
            "sigma, precision: both say how precise data are; give one of them."
        )
    tangent = tangent_frames(target, y)
    axes = orthonormal_axes(target, y, tangent)
    matrices = as_numbers("precision", precision)
    if frames is None:
        matrices = _ambient(target, matrices, len(y))
        reduced = np.swapaxes(tangent, 1, 2) @ _symmetric(matrices) @ tangent
    else:
        axes = _frames(target, y, as_numbers("frames", frames), axes)
        _check_intrinsic(target, matrices, len(y))
        reduced = _symmetric(matrices)
    values, vectors = np.linalg.eigh(reduced)
    values = _semidefinite(values, _largest(matrices))
    return Noise(jax.device_put(values), jax.device_put(axes @ vectors))


def _isotropic(sigma: Numbers, k: int) -> Noise:
    sigma = as_numbers("sigma", sigma)
    if sigma.shape not in ((), (k,)):
        raise ValueError(
            f"sigma: expected one number, or shape ({k},), one for each datum, found "
            f"{sigma.shape}. If it differs by direction, give `precision`."
        )
    demand = "must be positive and finite"
    refuse_other_than_positive("sigma", sigma.ravel(), demand, NO_NOISE)
    return Noise(jax.device_put(np.broadcast_to(sigma, k) ** -2.0), None)


def _ambient(target, matrices: np.ndarray, k: int) -> Float[np.ndarray, "k t t"]:
    shape, t, n = target.point_shape, math.prod(target.point_shape), target.dim
    if matrices.shape in ((k, t, t), (k, *shape, *shape)):
        return matrices.reshape(k, t, t)
    cure = ""
    if matrices.shape == (k, n, n):
        cure = f" For ({k}, {n}, {n}), give the `frames` of its coordinates, too."
    raise ValueError(_wrong_shape(target, matrices, k, (t, t), shape) + cure)


def _check_intrinsic(target, matrices: np.ndarray, k: int):
    n, t = target.dim, math.prod(target.point_shape)
    if matrices.shape != (k, n, n):
        message = _wrong_shape(target, matrices, k, (n, n)) + " Frames have n vectors."
        ambient = matrices.shape[0:1] == (k,) and matrices.size == k * t * t
        cure = " If it is one of ambient coordinates, leave out `frames`." * ambient
        raise ValueError(message + cure)


def _wrong_shape(target, matrices, k, one: tuple[int, ...], shape=()) -> str:
    n, t = target.dim, math.prod(target.point_shape)
    wanted = str((k, *one)) + f" or {(k, *shape, *shape)}" * (len(shape) > 1)
    text = (
        f"precision: expected shape {wanted} for {target.description} (t = {t} "
        f"coordinates, dimension n = {n}), found {matrices.shape}"
    )
    if matrices.shape in (one, shape + shape):
        each = f"np.broadcast_to(precision, {(k, *matrices.shape)})"
        return f"{text}. Give one for each datum: {each}."
    return text + "."


def _symmetric(matrices: Float[np.ndarray, "k a a"]) -> Float[np.ndarray, "k a a"]:
    bad = ~np.all(np.isfinite(matrices), axis=(1, 2))
    _refuse(bad, "hold NaN or infinity or are missing", NO_NOISE)
    transposed = np.swapaxes(matrices, 1, 2)
    gap, largest = _largest(matrices - transposed), _largest(matrices)
    worst = np.max(gap / np.where(largest > 0, largest, 1))
    _refuse(
        gap > SYMMETRIC * largest,
        f"are not symmetric, by up to {worst:.2g} of their largest entry",
        "Is it a Cholesky factor of the precision? Rounding: take (P + P^T) / 2.",
    )
    return (matrices + transposed) / 2


def _semidefinite(
    values: Float[np.ndarray, "k n"], largest: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "k n"]:
    """Those that are rounding are zero; of each something is left."""
    bad = np.any(values < -NEGATIVE * largest[:, None], axis=1)
    least = f", least {values[bad].min():.3g}" if bad.any() else ""
    _refuse(
        bad,
        f"have negative eigenvalues along the tangent space{least}",
        "A precision is the inverse of a covariance: make the least eigenvalues 0.",
    )
    _refuse(
        values.max(axis=1) <= NOTHING * largest,
        "are zero along the tangent space",
        NO_NOISE,
    )
    return np.where(values > NOTHING * largest[:, None], values, 0.0)


def _frames(
    target, y, frames: np.ndarray, basis: Float[np.ndarray, "k t n"]
) -> Float[np.ndarray, "k t n"]:
    """The orthonormal frames closest to those given, which are nearly so; as `basis` in
    orthonormal coordinates."""
    (k, t, n), shape = basis.shape, target.point_shape
    if frames.shape not in ((k, t, n), (k, *shape, n)):
        other = f" or {(k, *shape, n)}" * (len(shape) > 1)
        raise ValueError(
            f"frames: expected shape {(k, t, n)}{other} for {target.description}, tangent "
            f"vectors at each y as columns, found {frames.shape}."
        )
    frames = frames.reshape(k, t, n)
    bad = ~np.all(np.isfinite(frames), axis=(1, 2))
    _refuse(bad, "hold NaN or infinity or are missing", NO_NOISE, "frames")
    frames = orthonormal_axes(target, y, frames)
    inside = np.swapaxes(basis, 1, 2) @ frames
    off = np.linalg.norm(frames - basis @ inside, axis=1)
    _refuse(
        np.any(off > ALIKE * np.linalg.norm(frames, axis=1), axis=1),
        f"are not tangent at y but up to {off.max():.2g} across",
        "Project their columns, M.tangent_projection(y, column), and make them "
        "orthonormal, e.g. with np.linalg.qr.",
        "frames",
    )
    defect = _largest(np.swapaxes(frames, 1, 2) @ frames - np.eye(n))
    _refuse(
        defect > ALIKE,
        f"are not orthonormal: inner products are up to {defect.max():.2g} off",
        "Their vectors are columns, of length 1; np.linalg.qr makes such.",
        "frames",
    )
    left, _, right = np.linalg.svd(inside)
    return basis @ (left @ right)


def _largest(matrices: Float[np.ndarray, "k a b"]) -> Float[np.ndarray, " k"]:
    return np.max(np.abs(matrices), axis=(1, 2))


def _refuse(bad: np.ndarray, what: str, cure: str, name: str = "precision"):
    if bad.any():
        raise ValueError(
            f"{name}: {bad.sum()} of {len(bad)} {what} (first at index "
            f"{np.argmax(bad)}). {cure}"
        )
