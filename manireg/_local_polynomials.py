"""The function class: a partition of unity of local polynomials.

    Psi(x) = sum_i k_i(x) g_i(x) / sum_j k_j(x),   k_i(x) = k(|x - c_i| / sigma_i)

(paper, section 4). The polynomial g_i lives in the frame of its centre: all monomials up
to `degree` in the tangent coordinates (x - c_i)/sigma_i, and the normal coordinates
linearly. So every affine map of the ambient space is represented exactly: rotations of a
sphere, the identity of a head (mathematics: 8.4, T2n).
"""

import itertools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ._domain import Domain
from ._frames import complete_frames

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
    dim: int = eqx.field(static=True)
    degree: int = eqx.field(static=True)

    @property
    def size(self) -> int:
        """Polynomial coefficients per centre and output coordinate."""
        return len(self.exponents)

    @property
    def exponents(self) -> tuple[tuple[int, ...], ...]:
        m, s = self.dim, self.centres.shape[1]
        tangent = [
            tuple(np.bincount(factors, minlength=s).tolist())
            for degree in range(self.degree + 1)
            for factors in itertools.combinations_with_replacement(range(m), degree)
        ]
        normal = [tuple(int(i == j) for i in range(s)) for j in range(m, s)]
        return tuple(tangent + normal)


def local_polynomials(centres: Domain, widths, degree: int) -> LocalPolynomials:
    """Basis on the points and frames of a `Domain`; `widths` a number or one a centre."""
    widths = jnp.broadcast_to(jnp.asarray(widths, float), (len(centres.points),))
    frames = complete_frames(centres.frames)
    return LocalPolynomials(centres.points, frames, widths, centres.dim, degree)


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
    return jnp.stack([share * _monomial(local, e) for e in basis.exponents], 1).ravel()


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
