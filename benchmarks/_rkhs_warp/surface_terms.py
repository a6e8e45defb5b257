"""How far moved points are from a surface, and how differently it faces there."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from manireg.manifolds import PointCloud


class SurfaceTerms:
    """Residuals of the surface terms, four for each sample."""

    def __init__(self, target: PointCloud, facing, distance_weight, normal_weight):
        self.target, self.facing = target, facing
        self.distance_weight, self.normal_weight = distance_weight, normal_weight
        self.tree = KDTree(np.asarray(target.points))
        self.spacing = np.sqrt(np.median(np.asarray(target.areas)))

    def terms(self, p: Float[np.ndarray, "n 3"], s: float, share: float = 1.0):
        """The residuals as a function of the moved samples, for the patches nearest to
        `p`."""
        patches = self.target.patches(jnp.asarray(self.tree.query(p)[1]))
        foot, _, normal, _ = map(np.asarray, _at(patches, jnp.asarray(p)))
        # no counterpart: beyond a boundary of the target, or on its other side
        beyond = np.linalg.norm(foot - patches.origin, axis=1) > 2 * self.spacing
        met = ~beyond & (np.sum(normal * self.facing, axis=1) > 0)
        distance = np.sqrt(share * self.distance_weight) * met
        turn = np.sqrt(share * self.normal_weight) * s * met

        def residuals(p, slopes=False):
            _, height, normal, bend = map(np.asarray, _at(patches, jnp.asarray(p)))
            r = distance * height
            q = turn[:, None] * (normal - self.facing)
            r = np.concatenate([r[:, None], q], axis=1)
            if not slopes:
                return (r,)
            dr = (distance[:, None] * normal)[:, None]
            return r, np.concatenate([dr, turn[:, None, None] * bend], axis=1)

        return residuals


@eqx.filter_jit
def _at(patches, p):
    """Closest point, signed distance, its gradient and Hessian."""

    def one(patch, p):
        foot, normal = patch.project(p), patch.unit_normal(p)
        return foot, (p - foot) @ normal, normal, jax.jacfwd(patch.unit_normal)(p)

    return jax.vmap(one)(patches, p)
