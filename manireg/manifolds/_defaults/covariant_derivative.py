r"""Covariant derivatives of a curve $\gamma = \pi \circ \psi$ by automatic differentiation
of $a_1 = \gamma'$, $a_{j+1} = P(\gamma)\, a_j'$, functions of the derivatives of psi."""

from collections.abc import Callable, Sequence

import jax
from jaxtyping import Array, Float


def covariant_derivative(
    project: Callable[[Array], Array],
    tangent: Callable[[Array, Array], Array],
    psi: Sequence[Float[Array, "..."]],
) -> Float[Array, "..."]:
    r"""$(D/ds)^{p-1} \gamma'$ from $\psi, \psi', \dots, \psi^{(p)}$.

    **Arguments:** `project` the closest point projection, `tangent(p, v)` that of vectors.
    """
    p = len(psi) - 1
    if p == 1:
        return tangent(psi[0], psi[1])
    derivative = lambda y, *rows: tangent(y, rows[1])
    for _ in range(p - 2):
        derivative = _covariant(tangent, derivative)
    return derivative(*_image(project, p)(*psi))


def _image(f: Callable, order: int) -> Callable:
    """The derivatives of f o psi, up to that order, from those of psi."""
    if order == 0:
        return lambda psi: (f(psi),)
    lower = _image(f, order - 1)

    def image(*psi):
        values, derivatives = jax.jvp(lower, psi[:-1], psi[1:])
        return values[0], *derivatives

    return image


def _covariant(tangent: Callable, f: Callable) -> Callable:
    """P(y) df/ds of f(y, y', ...) along a curve."""

    def derivative(*rows):
        return tangent(rows[0], jax.jvp(f, rows[:-1], rows[1:])[1])

    return derivative
