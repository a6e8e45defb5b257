"""The flat torus: periodic data, with the energies of flat space."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float, PRNGKeyArray, ScalarLike

from .._algebra.smooth import (
    across,
    cos_sinc,
    norm_squared,
    off_zero,
    sphere_log,
    squared_angle,
)
from .._source import Chart
from ._base import AbstractManifold
from ._membership import is_concrete
from ._sphere import Sphere


class FlatTorus(AbstractManifold):
    r"""$T^n = S^1(r_1) \times \dots \times S^1(r_n) \subset \mathbb{R}^{2n}$; the point
    with angles $\theta_i$ is $(r_1\cos\theta_1, r_1\sin\theta_1, r_2\cos\theta_2, ..)$.

    **Arguments:** `dim` the dimension n >= 1; `radii` (default 1), one for all or
    `(n,)`.

    **Example:**

    ```python
    torus = mr.FlatTorus(2)
    p = jnp.array([1.0, 0.0, 1.0, 0.0])  # both angles 0
    q = jnp.array([0.0, 1.0, 0.0, 1.0])  # both angles a quarter turn
    torus.squared_distance(p, q)  # 4.9348
    ```
    """

    dim: int = eqx.field(static=True)
    radii: ScalarLike | Float[Array, " n"] = 1.0

    def __check_init__(self):
        if self.dim < 1:
            raise ValueError(f"FlatTorus: `dim` must be at least 1, found {self.dim}.")
        if jnp.shape(self.radii) not in ((), (self.dim,)):
            raise ValueError(
                f"FlatTorus: `radii` must be a scalar or of shape ({self.dim},), found "
                f"shape {jnp.shape(self.radii)}."
            )
        if is_concrete(self.radii) and not np.all(np.asarray(self.radii) > 0):
            raise ValueError(
                f"FlatTorus: `radii` must be positive, found {self.radii}."
            )

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (2 * self.dim,)

    @property
    def reach(self) -> ScalarLike:
        return jnp.min(jnp.asarray(self.radii))

    @property
    def injectivity_radius(self) -> ScalarLike:
        return np.pi * self.reach

    def _circles(self, p: Array) -> tuple[Array, Array]:
        """The points `(..., n, 2)` on the n circles, and the radii `(n, 1)`."""
        radii = jnp.broadcast_to(jnp.asarray(self.radii, float), (self.dim,))
        return p.reshape(*p.shape[:-1], self.dim, 2), radii[:, None]

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""$r_i p_i / |p_i|$ on each circle; where $p_i = 0$ and the whole circle is as
        close, $(r_i, 0)$, without derivatives."""
        x, radii = self._circles(p)
        x = off_zero(x)
        y = radii * x / jnp.linalg.norm(x, axis=-1, keepdims=True)
        return y.reshape(p.shape)

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$v_i - \langle p_i, v_i \rangle p_i / |p_i|^2$."""
        p, v = jnp.broadcast_arrays(p, v)
        (x, _), (w, _) = self._circles(p), self._circles(v)
        return across(off_zero(x), w).reshape(v.shape)

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$-\langle u_i, v_i \rangle p_i / r_i^2$."""
        p, u, v = jnp.broadcast_arrays(p, u, v)
        (x, radii), (a, _), (b, _) = map(self._circles, (p, u, v))
        bend = -jnp.sum(a * b, axis=-1, keepdims=True) * x / radii**2
        return bend.reshape(p.shape)

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\sum_i r_i^2 F(|p_i - q_i|^2 / r_i^2)$, see `squared_angle`."""
        gap, radii = self._circles(p - q)
        chord2 = norm_squared(gap)[..., None] / radii**2
        return jnp.sum(radii**2 * squared_angle(chord2), axis=(-2, -1))

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""The turn by $|v_i| / r_i$ on each circle."""
        p, v = jnp.broadcast_arrays(p, v)
        (x, radii), (w, _) = self._circles(p), self._circles(v)
        cosine, sinc = cos_sinc(norm_squared(w)[..., None] / radii**2)
        return (cosine * x + sinc * w).reshape(p.shape)

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\frac{\theta_i}{\sin\theta_i} P_{p_i} q_i$ on each circle, to rounding for
        all p, q. Where $q_i$ is opposite (the cut locus), one of the two ways round."""
        p, q = jnp.broadcast_arrays(p, q)
        (x, radii), (y, _) = self._circles(p), self._circles(q)
        return sphere_log(x, y, radii).reshape(p.shape)

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """Uniform."""
        return self.project(jax.random.normal(key, (n, *self.point_shape)))

    def chart(self, around: np.ndarray | None) -> Chart:
        r"""$(\theta_1, .., \theta_n)$."""
        radii = np.broadcast_to(np.asarray(self.radii, float), (self.dim,))
        turn = np.full(self.dim, 2 * np.pi)
        return Chart(0 * turn, turn, (True,) * self.dim, Partial(_embed, radii))

    def parts(self, *arrays: Any) -> "list[tuple]":
        """Circles: a wide one has no say in how close to a small one is close."""
        radii = np.broadcast_to(np.asarray(self.radii), self.dim)
        return [
            (
                f"FlatTorus, circle {i}" if self.dim > 1 else "FlatTorus",
                Sphere(1, float(radius)),
                *(a.reshape(len(a), -1, 2)[:, i] for a in arrays),
            )
            for i, radius in enumerate(radii)
        ]


def _embed(radii, u):
    return (radii * jnp.stack([jnp.cos(u), jnp.sin(u)])).T.ravel()
