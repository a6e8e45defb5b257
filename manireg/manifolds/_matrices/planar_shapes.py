"""Kendall's space of planar shapes: landmarks up to translation, scale and rotation."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, PRNGKeyArray

from ..._algebra.smooth import cos_sinc, norm_squared, squared_angle
from .._arrays import Numbers, as_array, first_index
from .._base import AbstractManifold
from .._membership import is_concrete
from .lines import line_log
from .matrix_functions import matmul, off_diagonal, symmetric_part, top_eigenprojector


class PlanarShapes(AbstractManifold):
    r"""Shapes of k landmarks in the plane, $\mathbb{CP}^{k-2}$: the Helmert coordinates
    $z \in \mathbb{C}^{k-1}$, |z| = 1, of a configuration up to a phase, stored as the
    projector $P = zz^*$ in a real array `(2, k-1, k-1)` (real part, imaginary part).

    The metric is the Frobenius metric: $d = \sqrt 2\, \theta$ for Kendall's distance
    $\theta = \arccos|\langle z, w \rangle|$. `from_landmarks` and `to_landmarks` go
    between landmarks `(..., k, 2)` and points.

    **Arguments:** `k` >= 3, the number of landmarks.

    **Example:** position, size and turn do not matter.

    ```python
    shapes = mr.PlanarShapes(3)
    triangle = np.array([[120, 40], [300, 55], [210, 260]])  # pixels
    turned = 7 - 2 * triangle
    p, q = shapes.from_landmarks(np.stack([triangle, turned]))
    shapes.squared_distance(p, q)  # 0.000
    ```
    """

    k: int = eqx.field(static=True)

    def __check_init__(self):
        if self.k < 3:
            raise ValueError(
                f"PlanarShapes: `k` must be at least 3 landmarks, found {self.k}; two "
                "landmarks have only one shape."
            )

    @property
    def dim(self) -> int:
        return 2 * self.k - 4

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (2, self.k - 1, self.k - 1)

    @property
    def reach(self) -> float:
        return math.sqrt(0.5)

    @property
    def injectivity_radius(self) -> float:
        return math.sqrt(0.5) * math.pi

    def from_landmarks(self, landmarks: Numbers) -> Float[Array, "..."]:
        """Shapes `(..., 2, k-1, k-1)` of landmarks `(..., k, 2)`: real numbers of any
        kind, such as integer pixels.

        **Raises:** ValueError for another shape, masked entries, or (outside of `jit`)
        where all k landmarks coincide, or one is not finite.
        """
        z = self._helmert_coordinates(landmarks)
        size2 = norm_squared(z.real) + norm_squared(z.imag)
        if is_concrete(size2):
            shapeless = np.asarray(~(size2 > 0) | ~jnp.isfinite(size2))
            if shapeless.any():
                raise ValueError(
                    f"PlanarShapes: `landmarks` holds {shapeless.sum()} of "
                    f"{shapeless.size} configurations without a shape (all landmarks "
                    "coincide, or one is NaN or infinite; first at index "
                    f"{first_index(shapeless)}); leave them out."
                )
        z = z / jnp.sqrt(size2)[..., None].astype(z.dtype)
        return _as_real(z[..., :, None] * jnp.conj(z[..., None, :]))

    def to_landmarks(
        self,
        p: Float[Array, "..."],
        reference: Numbers | None = None,
    ) -> Float[Array, "..."]:
        """Landmarks `(..., k, 2)` of shape `p`, centred and of unit size (the squared
        norms of the landmarks sum to 1).

        **Arguments:** `reference` landmarks `(..., k, 2)`: the rotation is the one that
        fits them best in least squares. Without it the edge from landmark 0 to landmark
        1 points along +x (NaN where these two coincide: give a reference).
        """
        h = _as_complex(p)
        if reference is None:
            z = h[..., :, 0]
        else:
            z = (h @ self._helmert_coordinates(reference)[..., None])[..., 0]
        size = jnp.sqrt(norm_squared(z.real) + norm_squared(z.imag))[..., None]
        helmert = jnp.asarray(_helmert(self.k), p.dtype)
        return jnp.stack([z.real / size @ helmert, z.imag / size @ helmert], axis=-1)

    def _helmert_coordinates(self, landmarks: Numbers) -> Complex[Array, "..."]:
        landmarks = as_array("PlanarShapes: `landmarks`", landmarks)
        if landmarks.shape[-2:] != (self.k, 2):
            raise ValueError(
                f"PlanarShapes: landmarks must have shape (..., {self.k}, 2), found "
                f"{landmarks.shape}."
            )
        # from one of them: far from the origin the differences have more digits
        xy = jnp.asarray(_helmert(self.k)) @ (landmarks - landmarks[..., :1, :])
        return jax.lax.complex(xy[..., 0], xy[..., 1])

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""Projector on the leading eigenvector of the Hermitian part of p; one of
        several, without derivatives, where $\lambda_1 = \lambda_2$."""
        return _as_real(self._projector(p))

    def _projector(self, p: Float[Array, "..."]) -> Complex[Array, "..."]:
        return top_eigenprojector(symmetric_part(_as_complex(p)), 1)

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$P Z (I - P) + (I - P) Z P$ with $P = \pi(p)$, Z the Hermitian part of v."""
        z = symmetric_part(_as_complex(v))
        return _as_real(off_diagonal(self._projector(p), z))

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$II_P(U, V) = (I - 2P)(UV + VU)$."""
        u, v = _as_complex(u), _as_complex(v)
        both = matmul(u, v) + matmul(v, u)
        return _as_real(both - 2 * matmul(_as_complex(p), both))

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$2\theta^2 = F(2|p - q|^2)/2$; near the cut locus ($\theta = \pi/2$)
        continued linearly in $|p - q|^2 = 2\sin^2\theta$."""
        return squared_angle(2 * norm_squared(p - q, 3)) / 2

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$c^2 P + cs V + s^2 VPV$ with $c = \cos\theta$, $s = \sin\theta/\theta$,
        $\theta = |V|/\sqrt 2$."""
        cosine, sinc = cos_sinc(norm_squared(v, 3)[..., None, None, None] / 2)
        x = _as_complex(v)
        return cosine * (cosine * p + sinc * v) + sinc**2 * _as_real(
            matmul(matmul(x, _as_complex(p)), x)
        )

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\frac{2\theta}{\sin 2\theta} P_p q$, to rounding for all p, q. For
        $\theta = \pi/2$ (the cut locus) it is one of the geodesics."""
        return _as_real(line_log(_as_complex(p), _as_complex(q)))

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """Uniform: the shapes of independent Gaussian landmarks."""
        return self.from_landmarks(jax.random.normal(key, (n, self.k, 2)))


def _helmert(k: int) -> np.ndarray:
    """Rows (-1, .., -1, j, 0, .., 0)/sqrt(j(j+1)), j = 1..k-1: orthonormal, each of sum
    zero; the first is the edge from landmark 0 to landmark 1."""
    j = np.arange(1, k)[:, None]
    column = np.arange(k)[None, :]
    rows = np.where(column < j, -1.0, np.where(column == j, j, 0.0))
    return rows / np.sqrt(j * (j + 1.0))


def _as_complex(p: Float[Array, "..."]) -> Complex[Array, "..."]:
    return jax.lax.complex(p[..., 0, :, :], p[..., 1, :, :])


def _as_real(h: Complex[Array, "..."]) -> Float[Array, "..."]:
    return jnp.stack([h.real, h.imag], axis=-3)
