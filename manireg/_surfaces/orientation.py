"""Do landmarks map the outside of one surface to the outside of the other?"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..manifolds import PointCloud

CLEAR = 0.25  # a mirror image has to fit so much better, in squared residuals
AGREED = 0.5  # mean sign of the normals' agreement, of landmarks, that decides


def normals_at(cloud: PointCloud, points) -> Float[np.ndarray, "l 3"]:
    return np.asarray(cloud.normals[cloud.nearest(jnp.asarray(points))])


def check_orientation(
    x: Float[np.ndarray, "l 3"],
    y: Float[np.ndarray, "l 3"],
    source_normals: Float[np.ndarray, "l 3"],
    target_normals: Float[np.ndarray, "l 3"],
) -> None:
    """The map next to that of the landmarks among rotations, reflections and scalings: if
    it is a reflection, or if it sends normals to the other side, the triangles of the
    source come out inside out on the target."""
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    x, y = x / np.linalg.norm(x), y / np.linalg.norm(y)
    u, s, vt = np.linalg.svd(y.T @ x)
    hand = np.sign(np.linalg.det(u @ vt))
    # squared residuals of the best map of the one and of the other hand
    best, other = 1 - np.sum(s) ** 2, 1 - (s[0] + s[1] - s[2]) ** 2
    known = best < CLEAR * other
    sides = np.sign(np.sum((source_normals @ (u @ vt).T) * target_normals, axis=1))
    # where landmarks lie in a plane, only the product knows
    reversed = hand * np.mean(sides) < -AGREED
    mirrored = known and hand < 0
    if mirrored and not reversed:
        raise ValueError(
            "target: a mirror image of the source by its landmarks, and its triangles are "
            "inside out. Mirror the vertices of one mesh and leave its triangles: "
            "`mesh.vertices = mesh.vertices * [-1, 1, 1]` (landmarks given as positions, "
            "too)."
        )
    if mirrored:
        raise ValueError(
            "target: a mirror image of the source by its landmarks; triangles would come "
            "out inside out. Mirror one mesh, which turns its triangles, too: "
            "`mesh.apply_transform(np.diag([-1.0, 1, 1, 1]))` (landmarks given as "
            "positions by hand). If the meshes are of the same hand, left and right are "
            "exchanged in one set of landmarks: exchange their names."
        )
    if reversed:
        plane = (
            "" if known else " If it is a mirror image of the source, mirror one mesh."
        )
        raise ValueError(
            "target: by the landmarks its normals point to the other side than those of "
            "the source; triangles would come out inside out. Turn those of the mesh that "
            f"is inside out: `mesh.invert()`.{plane}"
        )
