"""Signs of unit quaternions, of which both mean the same orientation."""

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

LINKS = 5  # poses ahead that signs are compared with


def lifted(
    t: Float[np.ndarray, " k"], q: Float[np.ndarray, "k 4"]
) -> Float[np.ndarray, "k 4"]:
    """Quaternions with signs that agree along the smallest turns between poses a few
    apart: a spanning tree passes by the side of outliers, which a chain would go
    through."""
    along = np.argsort(t, kind="stable")
    here, there = [], []
    for ahead in range(1, min(LINKS, len(t) - 1) + 1):
        here.append(along[:-ahead])
        there.append(along[ahead:])
    a, b = np.concatenate(here), np.concatenate(there)
    angle = 2 * np.arccos(np.clip(np.abs(np.sum(q[a] * q[b], axis=1)), 0.0, 1.0))
    graph = coo_array((angle + 1e-9, (a, b)), shape=(len(t), len(t)))
    tree = minimum_spanning_tree(graph.tocsr())
    order, parent = breadth_first_order(tree, along[0], directed=False)
    found = q.copy()
    for i in order[1:]:
        found[i] *= 1.0 if found[i] @ found[parent[i]] >= 0 else -1.0
    return found
