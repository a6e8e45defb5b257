"""Functions of matrices whose derivatives are exact to all orders, also where singular
values or eigenvalues coincide (there the derivative of `svd` and `eigh` is NaN).

The projections are `jax.custom_jvp` functions whose rule calls the function itself, so
that it can be differentiated again. They return the decomposition with the value, of
tangent zero, because all linear solves of the rules use it: one decomposition serves
derivatives of any order. Arguments are `(..., n, n)`, or `(..., n, p)` where said.
"""

import functools
import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._algebra.small import eigh, svd
from ..._algebra.smooth import norm_squared


def symmetric_part(a: Float[Array, "..."]) -> Float[Array, "..."]:
    return (a + a.mT) / 2


def skew_part(a: Float[Array, "..."]) -> Float[Array, "..."]:
    return (a - a.mT) / 2


def identity_like(a: Float[Array, "..."]) -> Float[Array, "..."]:
    return jnp.broadcast_to(jnp.eye(a.shape[-1], dtype=a.dtype), a.shape)


Eigen = tuple[Float[Array, "..."], Float[Array, "..."]]
"""Eigenvalues and eigenvectors of a symmetric matrix."""


def lyapunov(
    s: Float[Array, "..."], eigen: Eigen, k: Float[Array, "..."]
) -> Float[Array, "..."]:
    """X with s X + X s = k, for symmetric s without opposite eigenvalues. A linear solve
    to JAX, so that `eigen`, of s, is never differentiated."""
    values, vectors = jax.lax.stop_gradient(eigen)
    sums = values[..., :, None] + values[..., None, :]
    # A zero sum of an eigenvalue with itself meets a zero of k (skew k): 0/1, not 0/0
    sums = jnp.where(sums == 0.0, 1.0, sums)
    solve = lambda _, k: vectors @ ((vectors.mT @ k @ vectors) / sums) @ vectors.mT
    s, k = jnp.broadcast_arrays(s, k)
    forward = lambda x: s @ x + x @ s
    return jax.lax.custom_linear_solve(forward, k, solve, symmetric=True)


def _symmetric_solve(
    s: Float[Array, "..."], eigen: Eigen, k: Float[Array, "..."]
) -> Float[Array, "..."]:
    """X with s X = k for symmetric s, in the same way."""
    values, vectors = jax.lax.stop_gradient(eigen)
    solve = lambda _, k: vectors @ ((vectors.mT @ k) / values[..., :, None])
    return jax.lax.custom_linear_solve(lambda x: s @ x, k, solve, symmetric=True)


def _skew_lyapunov(
    s: Float[Array, "..."], eigen: Eigen | None, k: Float[Array, "..."]
) -> Float[Array, "..."]:
    r"""Skew $\Omega$ with $s\Omega + \Omega s = k$ for symmetric s, skew k. For n = 3
    it is $M k M / \det M$ with $M = \mathrm{tr}(s) I - s$."""
    n = s.shape[-1]
    trace = jnp.trace(s, axis1=-2, axis2=-1)[..., None, None]
    if n < 3:
        return k / trace
    if eigen is not None:
        return skew_part(lyapunov(s, eigen, k))
    m = trace * identity_like(s) - s
    a, b, c = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    d, e, f = m[..., 1, 2], m[..., 0, 2], m[..., 0, 1]
    det = a * b * c + 2 * d * e * f - a * d**2 - b * e**2 - c * f**2
    return m @ k @ m / det[..., None, None]


def _polar_tangent(
    y: Float[Array, "..."],
    eigen: Eigen | None,
    p: Float[Array, "..."],
    dp: Float[Array, "..."],
) -> Float[Array, "..."]:
    r"""Derivative of the factor y in p = y s, y with orthonormal columns, s symmetric:
    $dy = y\Omega + (I - yy^T)\, dp\, s^{-1}$ with
    $s\Omega + \Omega s = y^T dp - dp^T y$. `eigen`, of s, may be None for n = 3."""
    s = symmetric_part(y.mT @ p)
    inner = y.mT @ dp
    dy = y @ _skew_lyapunov(s, eigen, inner - inner.mT)
    if y.shape[-2] == y.shape[-1]:
        return dy
    assert eigen is not None
    normal = dp - y @ inner
    return dy + _symmetric_solve(s, eigen, normal.mT).mT


def polar_factor(p: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""$p\,(p^T p)^{-1/2}$ for p of shape `(..., n, p)`: the closest matrix with
    orthonormal columns; one of several where p has not full rank."""
    return _polar(p)[0]


@jax.custom_jvp
def _polar(p):
    u, values, vt = svd(p)
    return u @ vt, (values, vt.mT)


@_polar.defjvp
def _polar_jvp(primals, tangents):
    (p,), (dp,) = primals, tangents
    y, eigen = _polar(p)
    dy = _polar_tangent(y, eigen, p, dp)
    return (y, eigen), (dy, _constant(eigen))


def _constant(decomposition):
    """Tangents of what is not to be differentiated."""
    return jax.tree.map(jnp.zeros_like, decomposition)


@jax.custom_batching.custom_vmap
def _foam(p: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""Closest rotation for n = 3 without an SVD (Markley's FOAM, 1993). The largest
    root of $(\lambda^2 - |p|^2)^2 - 8 \lambda \det p - 4 |\mathrm{cof}\, p|^2$ is
    $\lambda = s_1 + s_2 + \mathrm{sign}(\det p) s_3$; p is scaled to |p| = 1 first.
    Near the medial axis, where it loses digits, by an SVD."""
    original, size2 = p, norm_squared(p, 2)
    p = p / jnp.sqrt(jnp.where(size2 > 0.0, size2, 1.0))[..., None, None]
    cofactors = jnp.cross(jnp.roll(p, -1, axis=-2), jnp.roll(p, -2, axis=-2))
    det = jnp.sum(p[..., 0, :] * cofactors[..., 0, :], axis=-1)
    constant = 4 * norm_squared(cofactors, 2)

    def newton(_, root):
        gap = root**2 - 1.0
        slope = 4 * root * gap - 8 * det
        value = gap**2 - 8 * root * det - constant
        return root - value / jnp.where(slope > 0.0, slope, 1.0)

    # From an upper bound Newton descends to the root; 30 steps halve the error 30 times
    # even where the root is double (medial axis).
    root = jax.lax.fori_loop(0, 30, newton, jnp.full_like(det, math.sqrt(3.0)))
    kappa = (root**2 - 1.0) / 2
    scale = (kappa * root - det)[..., None, None]
    kappa, root = kappa[..., None, None], root[..., None, None]
    y = ((kappa + 1.0) * p + root * cofactors - p @ p.mT @ p) / scale
    for _ in range(2):  # removes the rounding from y^T y - I
        y = 1.5 * y - 0.5 * (y @ y.mT @ y)
    lost = scale < _FEW_DIGITS
    by_svd = lambda: jnp.where(lost, _rotation_by_svd(original)[0], y)
    return jax.lax.cond(jnp.any(lost), by_svd, lambda: y)


@_foam.def_vmap
def _(axis_size, in_batched, p):
    return _foam(p), True  # of the whole batch: one condition


_FEW_DIGITS = 1e-5  # (s_1 + s_2)(s_2 + s_3)(s_3 + s_1) with signed s_3 and |s| = 1


def _rotation_by_svd(p: Float[Array, "..."]) -> tuple[Float[Array, "..."], Eigen]:
    u, values, vt = svd(p)
    sign = jnp.sign(jnp.linalg.det(u @ vt))[..., None]
    signs = jnp.concatenate([jnp.ones_like(values[..., 1:]), sign], axis=-1)
    return (u * signs[..., None, :]) @ vt, (values * signs, vt.mT)


def closest_rotation(p: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""$u\, \mathrm{diag}(1, \dots, 1, \det uv^T)\, v^T$ for p with singular value
    decomposition $u s v^T$; one of several where $s_{n-1} + \mathrm{sign}(\det p) s_n$
    is 0."""
    return _rotation(p)[0]


@jax.custom_jvp
def _rotation(p) -> tuple[Array, Eigen | None]:
    if p.shape[-1] == 3:
        return _foam(p), None
    return _rotation_by_svd(p)


@_rotation.defjvp
def _rotation_jvp(primals, tangents):
    (p,), (dp,) = primals, tangents
    y, eigen = _rotation(p)
    dy = _polar_tangent(y, eigen, p, dp)
    return (y, eigen), (dy, _constant(eigen))


def top_eigenprojector(s: Float[Array, "..."], rank: int) -> Float[Array, "..."]:
    r"""Orthogonal projector on the span of the `rank` leading eigenvectors of the
    symmetric s; one of several where $\lambda_\mathrm{rank} =
    \lambda_{\mathrm{rank}+1}$."""
    return _top(s, rank)[0]


@functools.partial(jax.custom_jvp, nondiff_argnums=(1,))
def _top(s, rank):
    values, vectors = eigh(s)
    leading = vectors[..., -rank:]
    return leading @ leading.mT, (values, vectors)


@_top.defjvp
def _top_jvp(rank, primals, tangents):
    r"""$dy$ solves $m\, dy + dy\, m = P_y(ds)$ with $m = (2y - I)(s - c I)$, c inside
    the gap: m is positive definite, and dy does not depend on c."""
    (s,), (ds,) = primals, tangents
    y, eigen = _top(s, rank)
    values, vectors = eigen
    n = s.shape[-1]
    middle = (values[..., n - rank] + values[..., n - rank - 1]) / 2
    one = identity_like(s)
    shifted = s - middle[..., None, None] * one
    m = symmetric_part((2 * y - one) @ shifted)
    eigen_of_m = jnp.abs(values - middle[..., None]), vectors
    dy = lyapunov(m, eigen_of_m, off_diagonal(y, ds))
    return (y, eigen), (dy, _constant(eigen))


def off_diagonal(y: Float[Array, "..."], v: Float[Array, "..."]) -> Float[Array, "..."]:
    """y v (I - y) + (I - y) v y: the projection of a symmetric v on the tangent space
    of the projectors at y."""
    yv = y @ v
    return yv + v @ y - 2 * (yv @ y)
