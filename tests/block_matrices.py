"""Random symmetric matrices of blocks, pairs of distant centres left out."""

import jax.numpy as jnp
import numpy as np

from manireg._algebra.sparse import SparseSymmetric, SparsityPattern

CENTRES, FUNCTIONS, T = 12, 2, 3
SIZES = CENTRES * FUNCTIONS, T
_rows, _cols = np.triu_indices(CENTRES)
_kept = _cols - _rows < 4
PATTERN = SparsityPattern(
    jnp.asarray(_rows[_kept], dtype=jnp.int32),
    jnp.asarray(_cols[_kept], dtype=jnp.int32),
    CENTRES,
    FUNCTIONS,
    band=4,
)


def random_matrix(seed: int) -> SparseSymmetric:
    """Positive definite; its diagonal spans four orders of magnitude."""
    rng = np.random.default_rng(seed)
    rows, cols = np.asarray(PATTERN.rows), np.asarray(PATTERN.cols)
    b = FUNCTIONS * T
    blocks = rng.uniform(-1, 1, size=(len(rows), b, b))
    own = rows == cols
    blocks[own] += blocks[own].swapaxes(1, 2) + 2 * CENTRES * b * np.eye(b)
    unit = 10.0 ** rng.uniform(-1, 1, size=(CENTRES, b))
    blocks *= unit[rows][:, :, None] * unit[cols][:, None, :]
    return SparseSymmetric(jnp.asarray(blocks), PATTERN)
