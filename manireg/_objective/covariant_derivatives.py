r"""Covariant derivatives of $\pi \circ \Psi$ from the jet of Psi, a map into the ambient
space: $a_1 = \gamma'$, $a_{j+1} = P(\gamma)\, a_j'$ along each geodesic of the source, and
the symmetric tensor that has these values."""

import functools
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._discretisation.partial_derivatives import multiplicities
from .._discretisation.polarisation import components, jets_along
from ..manifolds import AbstractManifold
from .terms import Jet, project_flat


def covariant_derivatives(
    near: AbstractManifold, jet: Jet, order: int
) -> Float[Array, "R t"]:
    r"""Components of the symmetrised $\nabla^{p-1} d\Phi$, $\Phi = \pi \circ \Psi$, each
    times the root of its multiplicity: the sum of their squares is that of the tensor."""
    m = len(jet.first)
    along = functools.partial(along_curve, near)
    if m == 1:  # under vmap an exact Hessian takes a third more
        return along([jet.value, *(rows[0] for rows in jet[1 : order + 1])])[None]
    partial = [jet.value[None], *map(jnp.stack, jet[1 : order + 1])]
    curves = [matrix @ rows for matrix, rows in zip(jets_along(m, order), partial)]
    return roots(m, order) * (components(m, order) @ jax.vmap(along)(curves))


def along_curve(
    near: AbstractManifold, psi: Sequence[Float[Array, " t"]]
) -> Float[Array, " t"]:
    r"""$a_p = (D/ds)^{p-1} \gamma'$ at s = 0, of the curve $\gamma = \pi \circ \psi$ with
    the derivatives $\psi, \psi', \dots, \psi^{(p)}$."""
    project = lambda p: project_flat(near, p)

    def tangent(p, v):
        shape = near.point_shape
        return near.tangent_projection(p.reshape(shape), v.reshape(shape)).ravel()

    p = len(psi) - 1
    if p == 1:
        return tangent(psi[0], psi[1])
    gamma = _image(project, p)(*psi)
    # a_j as functions of the derivatives of gamma
    derivative = lambda y, *rows: tangent(y, rows[1])
    for _ in range(p - 2):
        derivative = _covariant(tangent, derivative)
    return derivative(*gamma)


def roots(m: int, order: int) -> Float[np.ndarray, "R 1"]:
    """What components are multiplied with to be those of an orthonormal basis."""
    return np.sqrt(multiplicities(m, order))[:, None]


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
