"""A piece of surface given as the graph of a quadric over a plane."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, ScalarLike

from ..._algebra.small import eigh
from ..._algebra.smooth import norm_squared
from .._base import AbstractManifold
from .._defaults.second_form import geodesic_exp

_STEPS = 8  # Newton steps to the closest point; from near points 4 are enough


class QuadricPatch(AbstractManifold):
    r"""The surface $u \mapsto o + T u + \nu\,(b \cdot u + \tfrac12 u^\top B u)$ in
    $\mathbb{R}^3$ (or curve in $\mathbb{R}^2$): what a `PointCloud` is near one of its
    points.

    **Arguments:** `origin` o, `frame` T with orthonormal columns, `normal` $\nu$,
    `slope` b, `bending` B. Ambient points are meant to be near o, compared with the
    radii of curvature.
    """

    # leading dimensions: a batch, for `vmap`
    origin: Float[Array, "*b s"]
    frame: Float[Array, "*b s m"]
    normal: Float[Array, "*b s"]
    slope: Float[Array, "*b m"]
    bending: Float[Array, "*b m m"]

    @property
    def dim(self) -> int:
        return self.frame.shape[-1]

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.frame.shape[-2],)

    @property
    def reach(self) -> ScalarLike:
        """The smallest radius of curvature at the origin."""
        return 1.0 / jnp.max(jnp.abs(eigh(self.bending)[0]))

    @property
    def injectivity_radius(self) -> ScalarLike:
        return self.reach

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        """Closest point, by Newton's method in the plane."""
        return self._point(self._closest(p))

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        normal = self.unit_normal(p)
        return v - jnp.sum(normal * v, axis=-1, keepdims=True) * normal

    def unit_normal(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        """At the closest point of `p`, on the side of `normal`."""
        gradient = self._gradient(self._closest(p))
        normal = self.normal - gradient @ self.frame.T
        return normal / jnp.sqrt(1 + norm_squared(gradient))[..., None]

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$B(T^\top u, T^\top v)\, n / \sqrt{1 + |\nabla h|^2}$, n the unit normal."""
        gradient = self._gradient(self._closest(p))
        bend = jnp.sum((u @ self.frame @ self.bending) * (v @ self.frame), axis=-1)
        normal = self.normal - gradient @ self.frame.T
        return (bend / (1 + norm_squared(gradient)))[..., None] * normal

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """Of the chord: the geodesic one to third order."""
        return norm_squared(p - q)

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return geodesic_exp(self, p, v)

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """The projected chord: right to second order."""
        return self.tangent_projection(p, q - p)

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """Normally distributed around the origin, a tenth of the reach wide."""
        u = jax.random.normal(key, (n, self.dim)) * jnp.minimum(0.1 * self.reach, 1.0)
        return self._point(u)

    def _height(self, u):
        return u @ self.slope + 0.5 * jnp.sum((u @ self.bending) * u, axis=-1)

    def _gradient(self, u):
        return self.slope + u @ self.bending

    def _point(self, u):
        height = self._height(u)[..., None]
        return self.origin + u @ self.frame.T + height * self.normal

    def _closest(self, p):
        """Plane coordinates of the closest point."""
        return _closest(self, p)


@eqx.filter_custom_jvp
def _closest(patch: QuadricPatch, p):
    foot, height = _coordinates(patch, p)

    def newton(_, u):
        gauss, full, residual = _equations(patch, u, foot, height)
        # beyond the focal points the Hessian is indefinite: Gauss-Newton goes on
        convex = (_smallest_eigenvalue(full) > 0.1)[..., None, None]
        return u - _solve(jnp.where(convex, full, gauss), residual)

    return jax.lax.fori_loop(0, _STEPS, newton, foot)


@_closest.def_jvp
def _closest_jvp(primals, tangents):
    """Implicit: the residual r(u, p) stays zero. Calls `_closest` again, so derivatives of
    all orders follow."""
    patch, p = primals
    moved, dp = tangents
    if jax.tree.leaves(moved):
        raise NotImplementedError(
            "QuadricPatch: no derivatives with respect to the patch itself; "
            "hold the surface fixed (`jax.lax.stop_gradient`)."
        )
    u = _closest(patch, p)
    foot, height = _coordinates(patch, p)
    _, full, _ = _equations(patch, u, foot, height)
    dfoot, dheight = dp @ patch.frame, dp @ patch.normal
    return u, _solve(full, dfoot + dheight[..., None] * patch._gradient(u))


def _coordinates(patch: QuadricPatch, p):
    offset = p - patch.origin
    return offset @ patch.frame, offset @ patch.normal


def _equations(patch: QuadricPatch, u, foot, height):
    """Half the gradient of |point(u) - p|^2, and its derivative without and with the
    curvature."""
    gap = patch._height(u) - height
    gradient = patch._gradient(u)
    gauss = jnp.eye(patch.dim) + gradient[..., :, None] * gradient[..., None, :]
    full = gauss + gap[..., None, None] * patch.bending
    return gauss, full, u - foot + gap[..., None] * gradient


# in closed form: batches of one small matrix each are slow in LAPACK
def _smallest_eigenvalue(a):
    if a.shape[-1] == 1:
        return a[..., 0, 0]
    mean = 0.5 * (a[..., 0, 0] + a[..., 1, 1])
    return mean - jnp.sqrt((a[..., 0, 0] - mean) ** 2 + a[..., 0, 1] ** 2)


def _solve(a, b):
    if a.shape[-1] == 1:
        return b / a[..., 0]
    determinant = a[..., 0, 0] * a[..., 1, 1] - a[..., 0, 1] * a[..., 1, 0]
    x = a[..., 1, 1] * b[..., 0] - a[..., 0, 1] * b[..., 1]
    y = a[..., 0, 0] * b[..., 1] - a[..., 1, 0] * b[..., 0]
    return jnp.stack([x, y], axis=-1) / determinant[..., None]
