"""What a point cloud is near a map: one quadric patch for every quadrature point, datum.

Which patch it is depends on the nearest point of the cloud, which jumps; so the patches
are held fixed during a Newton solve and renewed before the next (paper, section 4).
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ._jets import jet_values
from ._problem import Problem
from .manifolds import PointCloud
from .manifolds._quadric_patch import QuadricPatch


class LocalTarget(eqx.Module):
    """Batched patches, arranged like the jets."""

    at_quadrature: QuadricPatch
    at_data: QuadricPatch
    nearest: tuple[Int[Array, "e p"], Int[Array, "d r"]]
    """Indices of their points in the cloud."""


def local_target(problem: Problem, w: Float[Array, "KC t"]) -> LocalTarget | None:
    """Around the map with coefficients `w`; None if the target needs no such thing."""
    cloud = problem.target
    if not isinstance(cloud, PointCloud):
        return None
    families = (problem.energy_jets, problem.data_jets)
    energy, data = (cloud.nearest(jet_values(jets, w)[:, :, 0]) for jets in families)
    return LocalTarget(cloud.patches(energy), cloud.patches(data), (energy, data))


def moved(old: LocalTarget, new: LocalTarget) -> Float[Array, ""]:
    """Share of the points whose patch has changed."""
    changed: list[Bool[Array, " n"]] = [
        (a != b).ravel() for a, b in zip(old.nearest, new.nearest, strict=True)
    ]
    return jnp.mean(jnp.concatenate(changed))
