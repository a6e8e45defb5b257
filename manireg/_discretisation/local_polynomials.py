"""The function class: a partition of unity of local polynomials.

    Psi(x) = sum_i k_i(x) g_i(x) / sum_j k_j(x),   k_i(x) = k(|x - c_i| / sigma_i)

(paper, section 4). The polynomial g_i lives in the frame of its centre: all monomials up
to `degree` in the tangent coordinates (x - c_i)/sigma_i, and the normal coordinates
linearly. So every affine map of the ambient space is represented exactly: rotations of a
sphere, the identity of a head (mathematics: 8.4, T2n).

On a smooth manifold the normal coordinate is nearly a quadratic of the tangent ones: on a
circle of 60 centres to 1e-3, which makes a Hessian singular to rounding. So the monomials
are made orthonormal around each centre, in their order; the space of maps is the same.
"""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from ..manifolds._defaults.frames import complete_frames
from .domain import Domain

# Least `cover` of a point. Where only the rims of supports meet, the quadrature misses how
# one polynomial passes into the next.
COVERED = 1e-4


class LocalPolynomials(eqx.Module):
    """K centres with frames and widths. `dim` is the dimension m of the source."""

    centres: Float[Array, "K s"]
    frames: Float[Array, "K s s"]
    """Columns: m tangent vectors, then s - m normals."""
    widths: Float[Array, " K"]
    """Support radius sigma_i of each centre's kernel."""
    mixing: Float[Array, "K C C"]
    """Functions of each centre: columns, in terms of the monomials."""
    dim: int = eqx.field(static=True)
    degree: int = eqx.field(static=True)

    @property
    def size(self) -> int:
        """Polynomial coefficients per centre and output coordinate."""
        return len(self.exponents)

    @property
    def exponents(self) -> tuple[tuple[int, ...], ...]:
        return _exponents(self.dim, self.centres.shape[1], self.degree)


AT_A_TIME = 512  # centres
DEPENDENT = 1e-6  # what those before leave of a monomial, a number below 1: less may be
# rounding, as of the normal coordinate on a plane, and stays small


def local_polynomials(
    centres: Domain, widths, degree: int, around: Domain
) -> LocalPolynomials:
    """Basis on the points and frames of a `Domain`; `widths` a number or one a centre.
    `around`: points of the source, some in every support."""
    K, s = centres.points.shape
    widths = np.broadcast_to(np.asarray(widths, float), (K,))
    tangent = np.asarray(centres.frames)
    if not centres.isometric:  # supports are balls of the ambient space
        tangent = np.linalg.qr(tangent)[0]
    frames = complete_frames(tangent)
    exponents = _exponents(centres.dim, s, degree)
    mixing = _orthonormal(centres.points, frames, widths, exponents, around.points)
    arrays = jax.device_put((centres.points, frames, widths, mixing))
    return LocalPolynomials(*arrays, dim=centres.dim, degree=degree)


def _exponents(m: int, s: int, degree: int) -> tuple[tuple[int, ...], ...]:
    tangent = [
        tuple(np.bincount(factors, minlength=s).tolist())
        for degree in range(degree + 1)
        for factors in itertools.combinations_with_replacement(range(m), degree)
    ]
    normal = [tuple(int(i == j) for i in range(s)) for j in range(m, s)]
    return tuple(tangent + normal)


def _orthonormal(centres, frames, widths, exponents, points) -> np.ndarray:
    """Mixing (K, C, C), upper triangular, that makes the monomials orthonormal with the
    kernel's weight over the `points` in each support. Host."""
    centres, frames, widths, points = map(np.asarray, (centres, frames, widths, points))
    inside = KDTree(points).query_ball_point(centres, widths)
    parts = []
    for start in range(0, len(centres), AT_A_TIME):
        some = slice(start, start + AT_A_TIME)
        own = [np.asarray(found, dtype=int) for found in inside[some]]
        count = np.array([len(found) for found in own])
        present = np.arange(max(count.max(), 1)) < count[:, None]
        index = np.zeros(present.shape, dtype=int)
        index[present] = np.concatenate(own)
        offset = (points[index] - centres[some, None]) / widths[some, None, None]
        weight = np.maximum(1 - np.sum(offset**2, axis=2), 0) ** 6 * present
        local = offset @ frames[some]
        values = np.stack([np.prod(local**e, axis=2) for e in exponents], axis=2)
        share = np.sqrt(weight / np.maximum(count, 1)[:, None])
        parts.append(_triangular(share[:, :, None] * values))
    return np.concatenate(parts)


def _triangular(values: Float[np.ndarray, "K P C"]) -> Float[np.ndarray, "K C C"]:
    """What makes the columns orthonormal, one after the other."""
    C = values.shape[2]
    # rows of zeros: there may be fewer points than monomials
    triangle = np.linalg.qr(np.pad(values, ((0, 0), (0, C), (0, 0))))[1]
    diagonal = np.arange(C)
    own = triangle[:, diagonal, diagonal]
    sign = np.where(own < 0, -1.0, 1.0)
    triangle[:, diagonal, diagonal] = sign * np.maximum(np.abs(own), DEPENDENT)
    return np.linalg.inv(triangle)


def kernel(q: Float[Array, "..."]) -> Float[Array, "..."]:
    """(1 - q)^6 of the squared scaled distance q, zero beyond q = 1: C^5, a polynomial,
    so no square root to differentiate at the centre."""
    return jnp.maximum(1.0 - q, 0.0) ** 6


def basis_values(
    basis: LocalPolynomials, x: Float[Array, " s"], near: Int[Array, " L"]
) -> Float[Array, " LC"]:
    """Values at one point of the basis functions of the centres `near`, which have to
    include every centre whose support holds x; -1 is padding. Centre-major order."""
    offset = (x - basis.centres[near]) / basis.widths[near, None]
    weight = jnp.where(near < 0, 0.0, kernel(jnp.sum(offset**2, axis=1)))
    local = jnp.einsum("ls,lsc->lc", offset, basis.frames[near])
    share = weight / jnp.sum(weight)
    monomials = jnp.stack([share * _monomial(local, e) for e in basis.exponents], 1)
    return jnp.einsum("lb,lbc->lc", monomials, basis.mixing[near]).ravel()


def _monomial(local: Float[Array, "L s"], exponents: tuple[int, ...]):
    # integer powers one by one: x**0 as an array power has no derivative at x = 0
    total = jnp.ones(len(local))
    for axis, power in enumerate(exponents):
        if power:
            total *= local[:, axis] ** power
    return total


def cover(
    basis: LocalPolynomials, x: Float[Array, " s"], near: Int[Array, " L"]
) -> Float[Array, ""]:
    """sum_i k_i(x) over the centres `near`, as for `basis_values`: zero where no centre
    reaches, so Psi is undefined."""
    offset = (x - basis.centres[near]) / basis.widths[near, None]
    return jnp.sum(jnp.where(near < 0, 0.0, kernel(jnp.sum(offset**2, axis=1))))
