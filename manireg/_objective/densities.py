"""Pointwise densities: what one quadrature point or one datum contributes.

All are pure functions of a jet of Psi in flattened ambient coordinates: a tuple of its
rows, first the value, then the m first derivatives, the others second derivatives (see
`_jets`). No array of rows: reverse mode makes padded arrays of its slices, a third of the
time of an exact Hessian. Energies come as residuals whose square is the density, because
their Jacobians, taken through the projector, are the Gauss-Newton blocks of the Hessian.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._discretisation.jets import second_derivative_pairs
from ..manifolds import AbstractManifold

Jet = Sequence[Float[Array, " t"]]


def project_flat(
    target: AbstractManifold, psi: Float[Array, " t"]
) -> Float[Array, " t"]:
    r"""$\pi(\Psi)$ in flattened coordinates."""
    return target.project(psi.reshape(target.point_shape)).ravel()


def _to_tangent(
    target: AbstractManifold, psi: Float[Array, " t"], vectors: Jet
) -> Float[Array, "r t"]:
    p = psi.reshape(target.point_shape)
    project = lambda v: target.tangent_projection(p, v.reshape(p.shape)).ravel()
    if len(vectors) == 1:  # of a curve: under vmap an exact Hessian takes a third more
        return project(vectors[0])[None]
    return jax.vmap(project)(jnp.stack(vectors))


def _multiplicities(m: int) -> Float[Array, "pairs 1"]:
    """Square roots: off-diagonal second derivatives count twice in |H|^2."""
    pairs = second_derivative_pairs(m)
    return jnp.array([[1.0 if a == b else np.sqrt(2.0)] for a, b in pairs])


def penalised_residual(
    target: AbstractManifold, jet: Jet, m: int
) -> Float[Array, "r t"]:
    r"""$|r|^2 = |P(\pi(\Psi)) H|^2$: the Eells density of the paper's (2), (5) for maps
    near N. The projector is that of the closest point, in any codimension."""
    return _multiplicities(m) * _to_tangent(target, jet[0], jet[1 + m :])


def tension_residual(
    target: AbstractManifold,
    jet: Jet,
    strength: Float[Array, ""],
    derivative: Float[Array, "m t"],
) -> Float[Array, "m t"]:
    r"""$|r|^2 = \tau |P(\pi(\Psi)) (D\Psi - A)|^2 / h^2$."""
    stretching = [row - a for row, a in zip(jet[1:], derivative)]
    return strength * _to_tangent(target, jet[0], stretching)


def projected_residual(
    target: AbstractManifold, jet: Jet, m: int
) -> Float[Array, "r t"]:
    r"""$|r|^2$ = the Eells density of $\pi \circ \Psi$, a map into N:
    $P(D^2\pi[\partial_a\Psi, \partial_b\Psi] + D\pi\, H_{ab})$ (mathematics, 2.6 (ii)).
    Blind to displacements of Psi normal to N."""
    value, first, second = jet[0], jet[1 : 1 + m], jet[1 + m :]
    rows = []
    for (a, b), h in zip(second_derivative_pairs(m), second):
        push = lambda psi, v: jax.jvp(lambda p: project_flat(target, p), (psi,), (v,))[
            1
        ]
        _, row = jax.jvp(push, (value, first[a]), (first[b], h))
        rows.append(row)
    return _multiplicities(m) * _to_tangent(target, value, rows)


def off_manifold_residual(
    target: AbstractManifold, psi: Float[Array, " t"]
) -> Float[Array, " t"]:
    r"""$\Psi - \pi(\Psi)$."""
    return psi - project_flat(target, psi)


def geodesic_loss(
    target: AbstractManifold, psi: Float[Array, " t"], y: Float[Array, " t"]
) -> Float[Array, ""]:
    r"""$d_N(y, \pi(\Psi))^2$."""
    p = target.project(psi.reshape(target.point_shape))
    return target.squared_distance(p, y.reshape(target.point_shape))
