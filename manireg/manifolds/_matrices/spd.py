"""Symmetric positive definite matrices, known by their logarithms: what their metrics
have in common, and the log-Euclidean one."""

from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float, PRNGKeyArray

from ..._source import Chart, bounding_box
from .._arrays import Numbers, as_array, first_index
from .._base import AbstractManifold
from .._defaults.frames import metric_of_chart, tangent_frames
from .._membership import is_concrete
from .matrix_exponentials import symmetric_log
from .matrix_functions import symmetric_part


class AbstractPositiveDefinite(AbstractManifold):
    """A point is the symmetric matrix $L = \\log S$, `(n, n)`: what S is, is positive
    definite whatever L is."""

    if TYPE_CHECKING:
        # a type checker would take an `AbstractVar` for an argument of the constructor
        n: Any
    else:
        n: eqx.AbstractVar[int]

    def __check_init__(self):
        if self.n < 1:
            raise ValueError(
                f"{type(self).__name__}: `n` must be at least 1, found {self.n}."
            )

    @property
    def dim(self) -> int:
        return self.n * (self.n + 1) // 2

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.n, self.n)

    @property
    def reach(self) -> float:
        return float("inf")

    @property
    def injectivity_radius(self) -> float:
        return float("inf")

    def from_matrices(self, matrices: Numbers) -> Float[Array, "..."]:
        r"""Points $L = \log S$ of matrices S `(..., n, n)`. Derivatives of all orders
        are exact, also at repeated eigenvalues; condition numbers up to 1e12.

        **Raises:** ValueError for another shape, masked entries, or (outside of `jit`)
        for a matrix that is not symmetric to 1e-6 or not positive definite.
        """
        matrices = as_array(f"{type(self).__name__}: `matrices`", matrices)
        if matrices.shape[-2:] != self.point_shape:
            raise ValueError(
                f"{type(self).__name__}: matrices must have shape (..., {self.n}, "
                f"{self.n}), found {matrices.shape}."
            )
        if is_concrete(matrices):
            _check_positive_definite(type(self).__name__, np.asarray(matrices))
        return symmetric_log(symmetric_part(matrices))

    def to_matrices(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""Matrices $S = \exp L$ of points L, both `(..., n, n)`."""
        return symmetric_part(jax.scipy.linalg.expm(symmetric_part(p)))

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""$(p + p^T)/2$."""
        return symmetric_part(p)

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$(v + v^T)/2$."""
        return symmetric_part(jnp.broadcast_arrays(p, v)[1])

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """Standard Gaussian on the symmetric matrices."""
        return self.project(jax.random.normal(key, (n, self.n, self.n)))

    def chart(self, around: np.ndarray | None) -> Chart:
        """Orthonormal coordinates of the linear span of logarithms, cut to the data."""
        basis = tangent_frames(self, np.zeros((1, self.n**2)))[0]
        low, high = bounding_box(self, None if around is None else around @ basis)
        span = Partial(jnp.matmul, basis)
        metric = None if self.isometric else metric_of_chart(self, span)
        return Chart(low, high, (False,) * self.dim, span, metric)

    def doubt(self, points: np.ndarray) -> str | None:
        """Matrices in place of their logarithms."""
        symmetric = (points + np.swapaxes(points, -1, -2)) / 2
        finite = len(points) > 0 and np.isfinite(points).all()
        if self.n < 2 or not finite or not (np.linalg.eigvalsh(symmetric) > 0).all():
            return None
        return (
            f"all {len(points)} points are positive definite themselves. Points of "
            f"{type(self).__name__} are logarithms: if these are the matrices S, "
            "convert them with M.from_matrices(S), and predictions with M.to_matrices. "
            "(Logarithms of matrices with all eigenvalues above 1 look like this, too.)"
        )


class SymmetricPositiveDefinite(AbstractPositiveDefinite):
    r"""Symmetric positive definite matrices S, $d(S_1, S_2) = |\log S_1 - \log S_2|_F$
    (log-Euclidean: Arsigny et al. 2006).

    **Points are logarithms.** A point is the symmetric matrix $L = \log S$, of shape
    `(n, n)`, not S: by $S \mapsto L$ the manifold is isometric to the flat space of all
    symmetric matrices, which is the embedding that the energies need. Use
    `from_matrices` on the data and `to_matrices` on predictions; these are positive
    definite whatever L is. On points everything is Euclidean: $II = 0$, geodesics
    are straight lines. `AffineInvariantSPD` has the metric that does not depend on the
    basis.

    **Arguments:** `n` >= 1, the size of the matrices.

    **Example:** the mean of determinants 1 and 16 is the geometric one.

    ```python
    spd = mr.SymmetricPositiveDefinite(2)
    p, q = spd.from_matrices(np.stack([np.eye(2), 4 * np.eye(2)]))
    jnp.linalg.det(spd.to_matrices((p + q) / 2))  # 4.000
    ```
    """

    references = ("arsigny2006log",)

    n: int = eqx.field(static=True)

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return jnp.zeros_like(jnp.broadcast_arrays(p, u, v)[0])

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$|p - q|_F^2$ (of logarithms)."""
        return jnp.sum((p - q) ** 2, axis=(-2, -1))

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """The straight line p + v (of logarithms); not the matrix exponential."""
        return p + v

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """The difference q - p (of logarithms); not the matrix logarithm."""
        return q - p


def _check_positive_definite(name: str, matrices: np.ndarray) -> None:
    size = np.max(np.abs(matrices), axis=(-2, -1), initial=0.0)
    asymmetry = np.abs(matrices - np.swapaxes(matrices, -1, -2)).max((-2, -1))
    askew = np.asarray(~(asymmetry <= 1e-6 * size))
    if askew.any():
        raise ValueError(
            f"{name}: `matrices` holds {askew.sum()} of {askew.size} "
            f"matrices that are not symmetric (first at index {first_index(askew)}, "
            f"largest asymmetry {np.max(asymmetry):.3g}); symmetrise."
        )
    smallest = np.linalg.eigvalsh(matrices)[..., 0]
    bad = np.asarray(~(smallest > 0))
    if bad.any():
        raise ValueError(
            f"{name}: `matrices` holds {bad.sum()} of {bad.size} "
            f"matrices (first at index {first_index(bad)}) with an eigenvalue that is not "
            f"positive, down to eigenvalue {smallest.min():.3g}; add a small multiple of "
            "the identity, or leave the matrices out."
        )
