"""Symmetric positive definite matrices with the affine-invariant metric."""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .matrix_exponentials import symmetric_exp, symmetric_log
from .matrix_functions import symmetric_part
from .spd import AbstractPositiveDefinite


class AffineInvariantSPD(AbstractPositiveDefinite):
    r"""Symmetric positive definite matrices S, $d(S_1, S_2) = |\log(S_1^{-1/2} S_2
    S_1^{-1/2})|_F$, the same for $A S_i A^T$ with any invertible A (Pennec, Fillard and
    Ayache 2006): tensors in millimetres or in the coordinates of another template. Where
    matrices commute it is the distance of `SymmetricPositiveDefinite`. Nonpositive
    curvature, no cut locus.

    **Points are logarithms**, as those of `SymmetricPositiveDefinite`: $L = \log S$,
    `(n, n)`; use `from_matrices` on data and `to_matrices` on predictions. Tangent
    vectors are derivatives of L. The metric is not that of the space of L: vectors have
    the `orthonormal` coordinates $S^{-1/2} \dot S S^{-1/2}$.

    **Arguments:** `n` >= 1, the size of the matrices.

    **Example:** the squared distance 2 (log 4)^2.

    ```python
    tensors = mr.AffineInvariantSPD(2)
    p, q = tensors.from_matrices(np.stack([np.diag([1.0, 4.0]), np.diag([4.0, 1.0])]))
    tensors.squared_distance(p, q)  # 3.84362
    ```
    """

    references = ("pennec2006riemannian",)

    n: int = eqx.field(static=True)

    @property
    def isometric(self) -> bool:
        return False

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\ddot L$ of geodesics, a quadratic form of $\dot L$, polarised."""
        p, u, v = jnp.broadcast_arrays(*map(symmetric_part, (p, u, v)))
        bend = lambda w: self.covariant_derivative([p, w, jnp.zeros_like(w)])
        return self.from_orthonormal(p, (bend(u - v) - bend(u + v)) / 4)

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return jnp.sum(self.residual(p, q) ** 2, axis=(-2, -1))

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""The logarithm of $S^{1/2} \exp(S^{-1/2} \dot S S^{-1/2}) S^{1/2}$."""
        root, _ = _roots(symmetric_part(p))
        step = symmetric_exp(self.orthonormal(p, v))
        return symmetric_log(_between(root, step))

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return self.from_orthonormal(p, self.residual(p, q))

    def orthonormal(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$S^{-1/2} \dot S S^{-1/2}$."""
        return 2 * symmetric_part(_turn(*jnp.broadcast_arrays(p, v)))

    def from_orthonormal(
        self, p: Float[Array, "..."], c: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        p, c = jnp.broadcast_arrays(symmetric_part(p), symmetric_part(c))
        root, _ = _roots(p)
        matrix, change = root @ root, _between(root, c)
        return jax.jvp(symmetric_log, (matrix,), (change,))[1]

    def residual(
        self, y: Float[Array, "..."], p: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$\log(Y^{-1/2} S Y^{-1/2})$, the coordinates of $\log_y p$."""
        _, inverse = _roots(symmetric_part(y))
        return symmetric_log(_between(inverse, symmetric_exp(symmetric_part(p))))

    def covariant_derivative(
        self, psi: Sequence[Float[Array, "..."]]
    ) -> Float[Array, "..."]:
        r"""In the frame that $S^{1/2}$ carries along: with $\theta = S^{-1/2} (S^{1/2})'$
        the velocity is $b = \theta + \theta^T$, and
        $Db/ds = b' + \omega b - b \omega$, $\omega = (\theta - \theta^T)/2$."""
        psi = [symmetric_part(row) for row in psi]
        derivative = lambda p, v: 2 * symmetric_part(_turn(p, v))
        for _ in range(len(psi) - 2):
            derivative = _covariant(derivative)
        return derivative(*psi)


def _covariant(f: Callable) -> Callable:
    """Of a vector f(L, L', ...) along a curve, in the frame of the roots."""

    def derivative(*rows):
        b, change = jax.jvp(f, rows[:-1], rows[1:])
        turn = _turn(rows[0], rows[1])
        around = ((turn - turn.mT) @ b) / 2
        return change + around + around.mT

    return derivative


def _turn(p: Float[Array, "..."], v: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""$\theta = S^{-1/2} (S^{1/2})'$ of $\dot L$ = v."""
    p, v = symmetric_part(p), symmetric_part(v)
    (_, inverse), (change, _) = jax.jvp(_roots, (p,), (v,))
    return inverse @ change


def _roots(p: Float[Array, "..."]) -> tuple[Array, Array]:
    """S^{1/2} and S^{-1/2}."""
    both = symmetric_exp(jnp.stack([p, -p]) / 2)
    return both[0], both[1]


def _between(a: Float[Array, "..."], s: Float[Array, "..."]) -> Float[Array, "..."]:
    """a s a, symmetric."""
    return symmetric_part(a @ s @ a)
