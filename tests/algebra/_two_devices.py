"""Run by test_sparse_cholesky.py in a process of its own, with two devices that solve in
turns. Prints how many factorisations that took, and the error."""

import jax
import jax.numpy as jnp
import numpy as np
import sparsax
from block_matrices import PATTERN, SIZES, random_matrix

import manireg as mr
from manireg._algebra.cholesky import SparseCholesky
from manireg._algebra.sparse import SparseSymmetric

LANES, SOLVES = 4, 20

solver = SparseCholesky()
matrices = [random_matrix(seed) for seed in range(LANES)]
right = jnp.asarray(np.random.default_rng(0).normal(size=SIZES))


def many_solves(blocks, right):
    state = solver.init(SparseSymmetric(blocks, PATTERN), {})

    def solve(_, x):
        x = solver.compute(state, x, {})[0]
        # a sum over devices waits for the other one
        return x + 0.0 * jax.lax.psum(x, "lanes")

    return jax.lax.fori_loop(0, SOLVES, solve, right)


found = mr.sweep(many_solves, jnp.stack([m.blocks for m in matrices]), right)
found, count = np.asarray(found), sparsax.factorization_count()
error = 0.0
for lane, matrix in enumerate(matrices):
    inverse = np.linalg.inv(np.asarray(matrix.as_matrix()))
    expected = np.linalg.matrix_power(inverse, SOLVES) @ np.asarray(right).ravel()
    size = np.abs(expected).max()
    error = max(error, np.abs(found[lane].ravel() - expected).max() / size)
print("devices", len(jax.devices()), "factorisations", count, "error", error)
