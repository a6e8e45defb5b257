"""Hyperbolic space, as the upper sheet of a hyperboloid."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray, ScalarLike

from .._algebra.smooth import angle_over_sinh, cosh_sinhc, squared_hyperbolic_angle
from .._source import Chart
from ._arrays import Numbers, as_array
from ._base import AbstractManifold
from ._defaults.normal_coordinates import normal_chart
from ._membership import is_concrete


class Hyperbolic(AbstractManifold):
    r"""$H^n(r) = \{p \in \mathbb{R}^{n+1} : \langle p, p \rangle = -r^2, p_0 > 0\}$ with
    the Lorentz product $\langle p, q \rangle = -p_0 q_0 + p_1 q_1 + \dots + p_n q_n$, of
    curvature $-1/r^2$ (Cannon et al. 1997, Hyperbolic Geometry, section 7).

    The metric is the Lorentz product of tangent vectors, not the Euclidean one of the
    ambient space. `from_ball` and `to_ball` are the coordinates of Poincare's ball.

    **Arguments:** `dim` the dimension n >= 1; `radius` (default 1), a float or a traced
    scalar.

    **Example:** the distance log 3.

    ```python
    plane = mr.Hyperbolic(2)
    p, q = plane.from_ball([[0.0, 0.0], [0.5, 0.0]])
    plane.squared_distance(p, q) ** 0.5  # 1.09861
    ```
    """

    dim: int = eqx.field(static=True)
    radius: ScalarLike = 1.0

    def __check_init__(self):
        if self.dim < 1:
            raise ValueError(f"Hyperbolic: `dim` must be at least 1, found {self.dim}.")
        if is_concrete(self.radius) and not np.asarray(self.radius) > 0:
            raise ValueError(
                f"Hyperbolic: `radius` must be positive, found {self.radius}."
            )

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.dim + 1,)

    @property
    def reach(self) -> float:
        return float("inf")

    @property
    def injectivity_radius(self) -> float:
        return float("inf")

    @property
    def isometric(self) -> bool:
        return False

    @property
    def origin(self) -> Float[Array, " t"]:
        """The tip of the sheet, $(r, 0, \\dots, 0)$."""
        return jnp.zeros(self.dim + 1).at[0].set(self.radius)

    def from_ball(self, u: Numbers) -> Float[Array, "..."]:
        r"""Points $\frac{r}{1 - |u|^2} (1 + |u|^2, 2u)$ of Poincare's ball $|u| < 1$,
        `(..., n)`.

        **Raises** ValueError (outside of `jit`) for points that are not inside.
        """
        u = as_array("Hyperbolic: points of the ball", u)
        square = jnp.sum(u**2, axis=-1, keepdims=True)
        outside = ~(square < 1)
        if is_concrete(u) and np.any(np.asarray(outside)):
            raise ValueError(
                f"Hyperbolic: {np.sum(outside)} of {outside.size} points do not lie "
                "inside the unit ball, |u| < 1."
            )
        p = jnp.concatenate([1 + square, 2 * u], axis=-1)
        return jnp.multiply(self.radius, p / (1 - square))

    def to_ball(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        """The inverse of `from_ball`."""
        return p[..., 1:] / (self.radius + p[..., :1])

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""$(\sqrt{r^2 + |x|^2}, x)$ of $p = (p_0, x)$: along the axis, so that every
        ambient point has an image."""
        x = p[..., 1:]
        height = jnp.sqrt(self.radius**2 + jnp.sum(x**2, axis=-1, keepdims=True))
        return jnp.concatenate([height, x], axis=-1)

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$v + \langle p, v \rangle p / r^2$ at $\pi(p)$."""
        p = self.project(p)
        return v + _lorentz(p, v) * p / self.radius**2

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\langle u, v \rangle p / r^2$."""
        return _lorentz(u, v) * p / self.radius**2

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$4 r^2 \mathrm{arsinh}^2(\sqrt{s} / 2)$, $s = \langle p - q, p - q \rangle
        / r^2$."""
        return squared_hyperbolic_angle(self._chord(p, q)[..., 0]) * self.radius**2

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\cosh(|v|/r) p + r \sinh(|v|/r) v / |v|$."""
        cosine, sine = cosh_sinhc(_lorentz(v, v) / self.radius**2)
        return self.project(cosine * p + sine * v)

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\frac{\theta}{\sinh\theta} (q - \cosh\theta\, p)$, $\theta = d(p, q)/r$."""
        chord = self._chord(p, q)
        return angle_over_sinh(chord) * ((q - p) - 0.5 * chord * p)

    def orthonormal(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """Of v carried to the `origin` along the geodesic, by a boost."""
        return v - v[..., :1] * (p + self.origin) / (self.radius + p[..., :1])

    def from_orthonormal(
        self, p: Float[Array, "..."], c: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r = self.radius
        return c + _lorentz(p, c) * (p + self.origin) / (r * (r + p[..., :1]))

    def residual(
        self, y: Float[Array, "..."], p: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\log_y p$."""
        return self.orthonormal(y, self.log(y, p))

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """Exponentials of standard Gaussian vectors at the origin, times the radius."""
        v = self.radius * jax.random.normal(key, (n, self.dim))
        v = jnp.concatenate([jnp.zeros((n, 1)), v], axis=1)
        return self.exp(self.origin, v)

    def chart(self, around: np.ndarray | None) -> Chart:
        """Normal coordinates at the origin, cut to the data."""
        return normal_chart(self, self.origin, around)

    def mistake(self, points: np.ndarray) -> tuple[Bool[np.ndarray, " k"], str, str]:
        """Points of the lower sheet."""
        lower = points[:, 0] < 0
        return lower, "points lie on the lower sheet of {}", "Change their sign: -p."

    def _chord(self, p, q):
        return _lorentz(p - q, p - q) / self.radius**2


def _lorentz(u: Float[Array, "..."], v: Float[Array, "..."]) -> Float[Array, "... 1"]:
    return (
        jnp.sum(u[..., 1:] * v[..., 1:], axis=-1, keepdims=True)
        - u[..., :1] * v[..., :1]
    )
