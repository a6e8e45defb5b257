"""Kendall's space of planar shapes: landmarks up to translation, scale and rotation."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, PRNGKeyArray

from .._algebra.smooth import (
    across,
    angle_over_sine,
    cos_sinc,
    norm_squared,
    off_zero,
    squared_angle,
)
from .._source import Chart
from ._arrays import Numbers, first_index
from ._base import AbstractManifold
from ._defaults.normal_coordinates import normal_chart
from ._membership import check_on, is_concrete
from ._preshapes import helmert, preshapes, turned

_CUT = 1e-3  # cosines of the distance to the reference at which coordinates end
_NEAR_CUT = 0.1
_ANOTHER = (
    "Take another reference: PlanarShapes(landmarks) with all landmarks (n, k, 2) has "
    "their mean."
)


class PlanarShapes(AbstractManifold):
    r"""Shapes of k landmarks in the plane, $\mathbb{CP}^{k-2}$, in coordinates that are
    aligned to a reference (Kendall 1984; Dryden and Mardia 2016, Statistical Shape
    Analysis, chapters 4 and 8).

    A configuration, centred and of unit size, is a unit vector z of
    $\mathbb{C}^{k-1}$, in an orthonormal basis whose first vector is the reference, and
    turned so that $z_1$ is real and positive: the rotation that fits the reference best
    (Procrustes). A point is the unit vector $(z_1, \mathrm{Re}\, z_{2 \dots},
    \mathrm{Im}\, z_{2 \dots})$ of $\mathbb{R}^{2k-3}$, on the half sphere
    $z_1 > 0$. `from_landmarks` and `to_landmarks` go between landmarks `(..., k, 2)` and
    points. Fits do not depend on the reference, but shapes at right angles to it
    ($z_1 = 0$: Kendall's distance $\pi/2$, the largest there is) have no point, and those
    near it need many centres: take the data.

    The metric is not that of the ambient space: $d = \sqrt 2\, \theta$ for Kendall's
    distance $\theta = \arccos|\langle z, w \rangle|$, for k = 3 that of a sphere of radius
    $1/\sqrt 2$.

    **Arguments:** `reference` landmarks `(k, 2)`, k >= 3, or those of many configurations,
    `(n, k, 2)`, whose mean shape it is (the leading eigenvector of $\sum_i z_i z_i^*$),
    turned as the first; real numbers of any kind, such as integer pixels.

    **Raises:** ValueError for another shape, masked entries, or (outside of `jit`) where
    all k landmarks coincide, or one is not finite.

    **Example:** position, size and turn do not matter.

    ```python
    triangle = np.array([[120, 40], [300, 55], [210, 260]])  # pixels
    shapes = mr.PlanarShapes(triangle)
    turned = 7 - 2 * triangle
    p, q = shapes.from_landmarks(np.stack([triangle, turned]))
    shapes.squared_distance(p, q)  # 0.000
    ```
    """

    references = ("kendall1984shape",)

    reference: Float[Array, "k 2"]

    def __init__(self, reference: Numbers):
        shape = np.shape(reference)
        if len(shape) not in (2, 3) or shape[-1] != 2:
            found = f"shape {shape}" if shape else f"{reference}"
            raise ValueError(
                "PlanarShapes: `reference` must be landmarks (k, 2) to which shapes are "
                "aligned, or those of many configurations, (n, k, 2), whose mean shape is "
                f"taken; found {found}."
            )
        if shape[-2] < 3:
            raise ValueError(
                f"PlanarShapes: `reference` must have at least 3 landmarks, found "
                f"{shape[-2]}; two landmarks have only one shape."
            )
        z = preshapes("reference", reference)
        if z.ndim == 2:
            mean = jnp.linalg.eigh(z.T @ jnp.conj(z))[1][:, -1]
            z = turned(mean, jnp.vdot(mean, z[0]))
        self.reference = jnp.stack([z.real, z.imag], axis=-1)

    @property
    def k(self) -> int:
        """The number of landmarks."""
        return self.reference.shape[-2]

    @property
    def dim(self) -> int:
        return 2 * self.k - 4

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (2 * self.k - 3,)

    @property
    def reach(self) -> float:
        return 1.0

    @property
    def injectivity_radius(self) -> float:
        return math.sqrt(0.5) * math.pi

    @property
    def isometric(self) -> bool:
        return False

    # Landmarks

    def from_landmarks(self, landmarks: Numbers) -> Float[Array, "..."]:
        """Shapes `(..., 2k-3)` of landmarks `(..., k, 2)`: real numbers of any kind, such
        as integer pixels.

        **Raises:** ValueError for another shape, masked entries, or (outside of `jit`)
        where all k landmarks coincide, one is not finite, or the shape is at right angles
        to the reference.
        """
        z = preshapes("landmarks", landmarks)
        if z.shape[-1] != self.k:
            raise ValueError(
                f"PlanarShapes: landmarks must have shape (..., {self.k}, 2), as the "
                f"reference, found {(*z.shape, 2)}."
            )
        z = jnp.sum(self._basis() * z[..., None, :], axis=-1)
        z = turned(z, jnp.conj(z[..., :1]))
        p = jnp.concatenate([z.real, z.imag[..., 1:]], axis=-1)
        if is_concrete(p):
            _refuse_cut("PlanarShapes: `landmarks`", np.asarray(p[..., 0]))
        return p

    def to_landmarks(
        self, p: Float[Array, "..."], reference: Numbers | None = None
    ) -> Float[Array, "..."]:
        """Landmarks `(..., k, 2)` of shape `p`, centred and of unit size (the squared
        norms of the landmarks sum to 1).

        **Arguments:** `reference` landmarks `(..., k, 2)`: the rotation is the one that
        fits them best in least squares (default: those of the manifold).
        """
        x, y = jnp.split(p[..., 1:], 2, axis=-1)
        z = jnp.concatenate([p[..., :1] + 0j, jax.lax.complex(x, y)], axis=-1)
        z = jnp.sum(jnp.conj(self._basis()) * z[..., None], axis=-2)
        if reference is not None:
            other = preshapes("reference", reference)
            z = turned(z, jnp.sum(jnp.conj(z) * other, axis=-1, keepdims=True))
        return jnp.stack([z.real, z.imag], axis=-1)

    def _basis(self) -> Complex[Array, "h k"]:
        """Rows $a_j$ of $z_j = a_j \\cdot z$ for centred landmarks z: a reflection of
        Helmert's that takes the reference to the first axis."""
        rows = helmert(self.k)
        r = rows @ jax.lax.complex(self.reference[:, 0], self.reference[:, 1])
        size = jnp.abs(r[0])
        phase = jnp.where(
            size > 0, -jnp.conj(r[0]) / jnp.where(size > 0, size, 1.0), 1.0
        )
        axis = phase * r - np.eye(1, self.k - 1)[0]  # phase r_0 < 0: no cancellation
        reflected = rows - jnp.outer(axis, jnp.conj(axis) @ rows) / (1.0 + size)
        return phase * reflected

    # Points on the half sphere

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""$\pm p / |p|$, with $p_1 \ge 0$: -z is z, turned."""
        p = off_zero(p)
        sign = jnp.where(p[..., :1] < 0, -1.0, 1.0)
        return sign * p * jax.lax.rsqrt(norm_squared(p))[..., None]

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$v - \langle p, v \rangle p / |p|^2$."""
        return across(off_zero(p), v)

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""The acceleration of geodesics, which turn as they go: $(2\tau^2 - |v|^2) z +
        2i\tau v - 2i\tau v_1 z / z_1$ for u = v, $\tau = \mathrm{Im}\langle z, v
        \rangle$."""
        tau_u, tau_v = _dot(_times_i(p), u), _dot(_times_i(p), v)
        along = 2 * tau_u * tau_v - _dot(u, v)
        turn = (tau_u * v[..., :1] + tau_v * u[..., :1]) / p[..., :1]
        return (
            along * p + tau_u * _times_i(v) + tau_v * _times_i(u) - turn * _times_i(p)
        )

    # The metric: that of the parts of tangent vectors which no turn accounts for

    def orthonormal(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\sqrt 2\, (v - z \langle z, v \rangle)$, carried to the reference along the
        geodesic: the first one is 0."""
        turn = _dot(_times_i(p), v) * _times_i(p)
        gone = v[..., :1] * _plus_reference(p) + turn
        return math.sqrt(2) * (v - gone / (1 + p[..., :1]))

    def from_orthonormal(
        self, p: Float[Array, "..."], c: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        c = math.sqrt(0.5) * c
        cosine, turn = p[..., :1], _dot(_times_i(p), c) * _times_i(p)
        back = turn / cosine - _dot(p, c) * _plus_reference(p)
        return c + back / (1 + cosine)

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$2\theta^2 = F(4 \sin^2\theta)/2$; near the cut locus ($\theta = \pi/2$)
        continued linearly in $\sin^2\theta = |w - z \langle z, w \rangle|^2$."""
        sine2 = norm_squared(self._across(p, q))
        return squared_angle(4 * sine2) / 2

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\cos\theta\, z + \frac{\sin\theta}{\theta} h$, turned, with the horizontal
        part h of v, $\theta = |h|$."""
        c = math.sqrt(0.5) * self.orthonormal(p, v)
        cosine, sinc = cos_sinc(norm_squared(c)[..., None])
        along, turn = _dot(p, c), _dot(_times_i(p), c)
        h = c - (along * _plus_reference(p) + turn * _times_i(p)) / (1 + p[..., :1])
        # the imaginary part of the first of h is -turn
        return _aligned(cosine * p + sinc * h, -sinc * turn)

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\frac{\theta}{\sin\theta} (w - \cos\theta\, z)$, w turned to z, to rounding
        for all p, q. For $\theta = \pi/2$ (the cut locus) it is one of the geodesics."""
        return self.from_orthonormal(p, self.residual(p, q))

    def residual(
        self, y: Float[Array, "..."], p: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\log_y p$."""
        h = self._across(y, p)
        sine2 = norm_squared(h)[..., None]
        real, imaginary = _dot(y, p), _dot(_times_i(y), p)
        cosine2 = real**2 + imaginary**2
        none = cosine2 == 0.0
        cosine = jnp.where(none, 0.0, jnp.sqrt(jnp.where(none, 1.0, cosine2)))
        back = real * h - imaginary * _times_i(h)
        back = jnp.where(none, h, back / jnp.where(none, 1.0, cosine))
        return math.sqrt(2) * angle_over_sine(2 * sine2 / (1 + cosine)) * back

    def _across(self, p, q):
        r"""$w - z \langle z, w \rangle$, carried to the reference."""
        return math.sqrt(0.5) * self.orthonormal(p, across(p, q - p))

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """Uniform: the shapes of independent Gaussian landmarks."""
        real, imaginary = jax.random.normal(key, (2, n, self.k - 1))
        p = jnp.concatenate([real, imaginary[:, 1:]], axis=1)
        return self.project(_aligned(p, imaginary[:, :1]))

    def chart(self, around: np.ndarray | None) -> Chart:
        """Normal coordinates at the reference, cut to the data."""
        if around is None:
            raise ValueError(
                "PlanarShapes as a source is cut to the data: pass `around`, those points."
            )
        chart = normal_chart(self, jnp.eye(1, 2 * self.k - 3)[0], around)
        corner = np.linalg.norm(np.maximum(np.abs(chart.lower), np.abs(chart.upper)))
        if not corner < 0.99 * self.injectivity_radius:
            raise ValueError(
                "PlanarShapes as a source is a box of normal coordinates at the "
                f"reference; that of `x` has a corner at {corner:.2g}, and they end at "
                f"{self.injectivity_radius:.2g}. {_ANOTHER}"
            )
        return chart

    # The place of data

    def check_points(self, name: str, x: np.ndarray, unit: str = "") -> None:
        """Also where they are at right angles to the reference."""
        check_on(name, self, x)
        _refuse_cut(name, x[..., 0])

    def mistake(self, points: np.ndarray) -> tuple[Bool[np.ndarray, " k"], str, str]:
        """Points of the other half sphere."""
        cure = "Change their sign, -p, or take those of `from_landmarks`."
        return points[:, 0] < 0, "points lie on the other half sphere of {}", cure

    def doubt(self, points: np.ndarray) -> str | None:
        """Shapes that are far from the reference."""
        far = np.sum(points[:, 0] < _NEAR_CUT)
        if not far:
            return None
        return (
            f"{far} of {len(points)} shapes are nearly at right angles to the reference, "
            f"where coordinates end. {_ANOTHER}"
        )


def _refuse_cut(name: str, cosines: np.ndarray) -> None:
    cut = cosines < _CUT
    if np.any(cut):
        raise ValueError(
            f"{name}: {cut.sum()} of {cut.size} shapes are at right angles to the "
            f"reference (first at index {first_index(cut)}), where coordinates end. "
            f"{_ANOTHER}"
        )


def _aligned(p: Float[Array, "..."], imaginary: Float[Array, "..."]) -> Array:
    """The shape whose first number has an imaginary part, turned so that it has none."""
    size2 = p[..., :1] ** 2 + imaginary**2
    size = jnp.sqrt(jnp.where(size2 > 0, size2, 1.0))
    rest = (p[..., :1] * p - imaginary * _times_i(p)) / size
    return jnp.concatenate([jnp.where(size2 > 0, size, 0.0), rest[..., 1:]], axis=-1)


def _times_i(p: Float[Array, "..."]) -> Float[Array, "..."]:
    """i z, but for its first number."""
    x, y = jnp.split(p[..., 1:], 2, axis=-1)
    return jnp.concatenate([jnp.zeros_like(p[..., :1]), -y, x], axis=-1)


def _dot(u: Float[Array, "..."], v: Float[Array, "..."]) -> Float[Array, "... 1"]:
    return jnp.sum(u * v, axis=-1, keepdims=True)


def _plus_reference(p: Float[Array, "..."]) -> Float[Array, "..."]:
    return p + np.eye(1, p.shape[-1])[0]
