r"""Covariant derivatives of a curve $\gamma = \pi \circ \psi$ by automatic differentiation
of the formula of Gauss, $a_{j+1} = a_j' - II(\gamma', a_j)$ with $a_1 = \gamma'$."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
from jaxtyping import Array, Float


def covariant_derivative(
    manifold: Any, psi: Sequence[Float[Array, "..."]]
) -> Float[Array, "..."]:
    r"""$(D/ds)^{p-1} \gamma'$ from $\psi, \psi', \dots, \psi^{(p)}$, by the projections
    and the second fundamental form of a manifold."""
    p = len(psi) - 1
    gamma = derivatives_along(manifold.project, p)(*psi)
    if p == 1:
        return gamma[1]
    if p == 2 and manifold.isometric:
        return manifold.tangent_projection(psi[0], gamma[2])
    form = manifold.second_fundamental_form
    derivative = lambda y, dy, ddy: ddy - form(y, dy, dy)
    for _ in range(p - 2):
        derivative = _covariant(form, derivative)
    return derivative(*gamma)


def derivatives_along(f: Callable, order: int) -> Callable:
    """The derivatives of f o psi, up to that order, from those of psi."""
    if order == 0:
        return lambda psi: (f(psi),)
    lower = derivatives_along(f, order - 1)

    def image(*psi):
        values, derivatives = jax.jvp(lower, psi[:-1], psi[1:])
        return values[0], *derivatives

    return image


def _covariant(form: Callable, f: Callable) -> Callable:
    """Of a tangent vector f(y, y', ...) along a curve."""

    def derivative(*rows):
        vector, change = jax.jvp(f, rows[:-1], rows[1:])
        return change - form(rows[0], rows[1], vector)

    return derivative
