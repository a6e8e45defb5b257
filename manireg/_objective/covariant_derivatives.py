r"""Covariant derivatives of $\pi \circ \Psi$ from the jet of Psi, a map into the ambient
space: those along geodesics of the source, and the symmetric tensor that has these
values."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._discretisation.partial_derivatives import multiplicities
from .._discretisation.polarisation import components, jets_along
from ..manifolds import AbstractManifold
from .terms import Jet


def covariant_derivatives(
    near: AbstractManifold, jet: Jet, order: int
) -> Float[Array, "R t"]:
    r"""Components of the symmetrised $\nabla^{p-1} d\Phi$, $\Phi = \pi \circ \Psi$, each
    times the root of its multiplicity: the sum of their squares is that of the tensor."""
    m = len(jet.first)
    if m == 1:  # under vmap an exact Hessian takes a third more
        rows = [jet.value, *(rows[0] for rows in jet[1 : order + 1])]
        return along_curve(near, rows)[None]
    partial = [jet.value[None], *map(jnp.stack, jet[1 : order + 1])]
    curves = [matrix @ rows for matrix, rows in zip(jets_along(m, order), partial)]
    values = jax.vmap(lambda *rows: along_curve(near, rows))(*curves)
    return roots(m, order) * (components(m, order) @ values)


def along_curve(
    near: AbstractManifold, psi: Sequence[Float[Array, " t"]]
) -> Float[Array, " t"]:
    r"""$(D/ds)^{p-1} (\pi \circ \psi)'$ of a curve with the derivatives
    $\psi, \psi', \dots, \psi^{(p)}$, in orthonormal coordinates, flattened."""
    points = [row.reshape(near.point_shape) for row in psi]
    return near.covariant_derivative(points).ravel()


def roots(m: int, order: int) -> Float[Array, "R 1"]:
    """What components are multiplied with to be those of an orthonormal basis."""
    return jnp.asarray(np.sqrt(multiplicities(m, order)))[:, None]
