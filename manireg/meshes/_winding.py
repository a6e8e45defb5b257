"""Which side of each triangle is out: the same for neighbours."""

import os

import numpy as np
import trimesh
from jaxtyping import Bool, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order

from ._edges import connected, shared_edges, sides_of
from ._mesh import as_mesh
from ._weld import Welded, weld

SHORT = 0.05  # of the size: length of the edges along which a tangle may disagree
TORN = 0.25  # share of triangles turned above which a closed surface is turned outwards


def wound_alike(mesh: trimesh.Trimesh | str | os.PathLike) -> trimesh.Trimesh:
    """The mesh (or the mesh in a file) with the fewest triangles turned around that makes
    all neighbours agree on their side; vertices and triangles keep their numbers. Closed
    surfaces of which more than a quarter would be turned come out with their normals
    outwards.

    **Raises** ValueError where that is impossible, as on a Moebius strip.

    **Example:**

    ```python
    ball = trimesh.creation.icosphere(subdivisions=2)
    ball.faces[:40] = ball.faces[:40, ::-1]
    mr.meshes.wound_alike(ball).is_winding_consistent  # True
    ```
    """
    mesh = as_mesh(mesh)
    welded = weld(mesh)
    faces = np.array(mesh.faces)
    turned = welded.faces[against_the_others(welded)]
    faces[turned] = faces[turned, ::-1]
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def against_the_others(welded: Welded) -> Bool[np.ndarray, " T"]:
    """The fewest triangles to turn around for neighbours to agree. Of each triangle there
    are two, as it is and turned; those that agree across an edge hang together."""
    triangles, T = welded.triangles, len(welded.triangles)
    sides = sides_of(triangles)
    one, pair, agree = shared_edges(sides)
    a, b = pair.T
    pairs = np.concatenate(
        [
            np.stack([a, np.where(agree, b, b + T)], axis=1),
            np.stack([a + T, np.where(agree, b + T, b)], axis=1),
        ]
    )
    group = connected(pairs, 2 * T)
    as_is, turned = group[:T], group[T:]
    votes = np.bincount(as_is, minlength=2 * T)
    fewer, tied = votes[as_is] < votes[turned], votes[as_is] == votes[turned]
    turn = fewer | (tied & (as_is > turned))
    one_sided = as_is == turned
    if np.any(one_sided):
        inside = one_sided[a]
        ends = welded.x[np.stack([sides.low[one], sides.high[one]])]
        length = np.linalg.norm(ends[1] - ends[0], axis=1)
        turn |= _tangled(one_sided, a[inside], b[inside], agree[inside], length[inside])
    piece = connected(np.stack([a, b], axis=1), T)
    minority = np.bincount(piece, turn) / np.bincount(piece)
    unclear = (minority > TORN) & ~_open(piece, sides)
    if np.any(unclear):
        here = unclear[piece]
        wound = np.where(turn[:, None], triangles[:, ::-1], triangles)
        inwards = np.bincount(piece, _volumes(welded.x, wound)) < 0
        turn ^= here & inwards[piece]
    return turn


def _tangled(one_sided, a, b, agree, length) -> Bool[np.ndarray, " T"]:
    """Where the surface has one side only, as around a few triangles of many a scan: as
    they are, or along a tree of neighbours, whichever disagrees less. Not for a surface
    that does so on the whole, as a Moebius strip."""
    T = len(one_sided)
    turn = np.zeros(T, bool)
    weights = np.where(agree, 1, 2)  # zeros are no entries
    graph = coo_array((weights, (a, b)), shape=(T, T)).tocsr()
    agreed = (graph + graph.T).tocsr()
    seen = ~one_sided
    while not seen.all():
        order, before = breadth_first_order(agreed, np.argmin(seen), directed=False)
        seen[order] = True
        steps = np.asarray(agreed[before[order[1:]], order[1:]]).ravel() == 2
        for here, there, other in zip(order[1:], before[order[1:]], steps):
            turn[here] = turn[there] ^ other
    wrong = lambda turn: float(np.sum(length[agree == (turn[a] ^ turn[b])]))
    as_is = np.zeros(T, bool)
    turn = min((as_is, turn), key=wrong)
    if wrong(turn) > SHORT:
        raise ValueError(
            "mesh: the surface has one side only, like a Moebius strip (around triangle "
            f"{np.flatnonzero(one_sided)[0]}); cut it."
        )
    return turn


def _open(piece: Int[np.ndarray, " T"], sides) -> Bool[np.ndarray, " p"]:
    ends = np.repeat(sides.uses != 2, sides.uses)
    return np.bincount(piece[sides.triangle], ends) > 0


def _volumes(x, triangles):
    """Signed, of the tetrahedra between each triangle and the origin."""
    a, b, c = np.moveaxis(x[triangles], 1, 0)
    return np.sum(a * np.cross(b, c), axis=1) / 6
