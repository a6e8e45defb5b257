"""What a point cloud is near a map: one quadric patch for every quadrature point, datum.

Which patch it is depends on the nearest point of the cloud, which jumps; so the patches
are held fixed during a Newton solve and renewed before the next (paper, section 4).
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from ..manifolds._scans.quadric_patch import QuadricPatch
from .problem import Problem, psi_jets

HOLD = 1.1  # by the n-th renewal a patch stays until another is nearer by HOLD^n
MOST_BEND = 0.5  # distance to a patch in units of its radius of curvature


class Patches(eqx.Module):
    """Of a cloud near a map, arranged like the jets: at the quadrature, at the data."""

    near: tuple[QuadricPatch, QuadricPatch]
    nearest: tuple[Int[Array, "e p"], Int[Array, "d r"]]
    """Indices of their points in the cloud."""


def patches_near(
    problem: Problem,
    w: Float[Array, "KC t"],
    held: Patches | None = None,
    renewals: ArrayLike = 1,
) -> Patches | None:
    """Around the map with coefficients `w`; None if the target needs no such thing. A
    patch of `held` stays until another point is nearer by a factor that grows with the
    renewals: two patches that each send the map to the other would be exchanged for ever,
    and a few of these keep an intrinsic energy from settling."""
    target: Any = problem.target
    families = (problem.energy_jets, problem.data_jets)
    values = [psi_jets(problem, jets, w)[:, :, 0] for jets in families]
    nearest = [target.nearest(psi) for psi in values]
    if nearest[0] is None:
        return None
    if held is not None:
        gap = lambda psi, i: jnp.linalg.norm(psi - target.points[i], axis=-1)
        nearest = [
            jnp.where(gap(psi, old) < HOLD**renewals * gap(psi, new), old, new)
            for psi, old, new in zip(values, held.nearest, nearest)
        ]
    energy, data = (
        _flattened(target.patches(i), psi)
        for i, psi in zip(nearest, values, strict=True)
    )
    return Patches((energy, data), (nearest[0], nearest[1]))


def _flattened(patches: QuadricPatch, psi: Float[Array, "e p t"]) -> QuadricPatch:
    """Bent no more than the distance to `psi` allows: beyond a patch's centres of
    curvature the closest point is not smooth. As Psi settles on N the bending returns."""
    gap = jnp.linalg.norm(psi - patches.origin, axis=-1)
    bend = jnp.linalg.norm(patches.bending, axis=(-2, -1)) * gap
    share = jnp.minimum(1.0, MOST_BEND / jnp.maximum(bend, 1e-300))
    return eqx.tree_at(
        lambda p: p.bending, patches, share[..., None, None] * patches.bending
    )


def moved(old: Patches, new: Patches) -> Float[Array, ""]:
    """Share of the points whose patch has changed."""
    changed: list[Bool[Array, " n"]] = [
        (a != b).ravel() for a, b in zip(old.nearest, new.nearest, strict=True)
    ]
    return jnp.mean(jnp.concatenate(changed))
