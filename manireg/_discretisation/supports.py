"""The few centres whose supports hold a point, inside a compiled program: an array of a
size that no point of the whole space exceeds. (On the host `jets.centres_near` counts.)"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from .._programs.sizes import bucket
from .local_polynomials import LocalPolynomials

SLACK = 1e-9  # of distances, for rounding
PAIRS = 1e8  # of pairs, so many are looked at: a second


def most_supports(basis: LocalPolynomials) -> int:
    """At least as many as there are supports with a common point, wherever it lies; all
    centres, if that is hardly more. Of a concrete basis."""
    centres, widths = np.asarray(basis.centres), np.asarray(basis.widths)
    most = bucket(_most(centres.tobytes(), widths.tobytes(), len(widths)))
    return most if 2 * most <= len(widths) else len(widths)


def supports_at(
    basis: LocalPolynomials, x: Float[Array, " s"], most: int
) -> Int[Array, " most"]:
    """The centres whose supports hold `x`, ascending; -1 is padding. There must be at
    most so many."""
    K = len(basis.centres)
    if most >= K:
        return jnp.arange(K)
    offset = (x - basis.centres) / basis.widths[:, None]
    inside = jnp.sum(offset**2, axis=1) < 1.0
    # float32: whole numbers are exact, and XLA has a fast selection for it
    key = jnp.where(inside, jnp.arange(K, 0, -1), 0).astype(jnp.float32)
    left, index = jax.lax.top_k(key, most)
    return jnp.where(left > 0, index, -1)


@functools.lru_cache(maxsize=32)
def _most(centres: bytes, widths: bytes, K: int) -> int:
    w = np.frombuffer(widths)
    c = np.frombuffer(centres).reshape(K, -1)
    around = KDTree(c).query_ball_point(c, (w + np.max(w)) * (1 + SLACK))
    sizes = np.array([len(some) for some in around])
    if np.sum(sizes**2) > PAIRS:
        return int(np.max(sizes))
    return max(
        _with_a_point(c[some], w[some], c[i], w[i]) for i, some in zip(range(K), around)
    )


def _with_a_point(c: Float[np.ndarray, "n s"], w, own, width) -> int:
    """Of supports with a common point let those of `own` and of c_j, D apart, have the
    farthest centres. Then all centres are within D of both, and all supports reach into
    the ball around the lens in which the two meet. As many as that is so for, over j."""
    distance = np.linalg.norm(c - own, axis=1)
    meets = distance <= (w + width) * (1 + SLACK)
    c, w, distance = c[meets], w[meets], distance[meets]
    squared = np.where(distance > 0, distance, 1.0) ** 2
    # where the rims meet, as a share of the way: 0 or 1 if half of the smaller ball is in
    share = np.clip(0.5 + (width**2 - w**2) / (2 * squared), 0.0, 1.0)
    middle = own + share[:, None] * (c - own)
    half = np.sqrt(np.maximum(width**2 - share**2 * squared, 0.0))
    radius = np.where(share == 1, w, half)
    limit = distance[:, None] * (1 + SLACK)
    inside = (distance <= limit) & (cdist(c, c) <= limit)
    inside &= cdist(middle, c) <= (radius[:, None] + w) * (1 + SLACK)
    return int(np.max(np.sum(inside, axis=1)))
