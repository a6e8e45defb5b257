"""CHOLMOD through sparsax against dense inverses, and how often it factorises."""

import os
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sparsax
from block_matrices import FUNCTIONS, PATTERN, SIZES, random_matrix

from manireg._algebra import covariances
from manireg._algebra.cholesky import BandCholesky, DenseCholesky, SparseCholesky
from manireg._algebra.covariances import CHUNK_BYTES, Elements
from manireg._algebra.sparse import SparseSymmetric

WORKER = Path(__file__).with_name("_two_devices.py")
SOLVER = SparseCholesky()
RIGHT = jnp.asarray(np.random.default_rng(1).normal(size=SIZES))


def inverse(matrix: SparseSymmetric):
    return np.linalg.inv(np.asarray(matrix.as_matrix()))


@eqx.filter_jit
def solve(matrix, right):
    return SOLVER.compute(SOLVER.init(matrix, {}), right, {})[0]


def of_blocks(function):
    """`function` of the blocks of a matrix, for `vmap`."""
    return lambda blocks: function(SparseSymmetric(blocks, PATTERN))


def test_solutions():
    matrix = random_matrix(0)
    sides = jnp.stack([RIGHT, -2 * RIGHT], axis=2)
    expected = (inverse(matrix) @ RIGHT.ravel()).reshape(SIZES)
    size = np.abs(expected).max()
    np.testing.assert_allclose(solve(matrix, RIGHT), expected, atol=1e-10 * size)
    several = np.stack([expected, -2 * expected], axis=2)
    np.testing.assert_allclose(solve(matrix, sides), several, atol=1e-10 * size)


def test_lanes_of_a_vmap():
    matrices = [random_matrix(seed) for seed in range(3)]
    blocks = jnp.stack([matrix.blocks for matrix in matrices])
    found = jax.vmap(of_blocks(lambda matrix: solve(matrix, RIGHT)))(blocks)
    for lane, matrix in zip(found, matrices, strict=True):
        expected = (inverse(matrix) @ RIGHT.ravel()).reshape(SIZES)
        size = np.abs(expected).max()
        np.testing.assert_allclose(lane, expected, atol=1e-10 * size)


@pytest.mark.parametrize("solver", [SOLVER, DenseCholesky(), BandCholesky()])
@pytest.mark.parametrize("chunk", [1.0, CHUNK_BYTES])
def test_covariances(solver, chunk, monkeypatch):
    """Of points whose functions are those of two or three centres."""
    monkeypatch.setattr(covariances, "CHUNK_BYTES", chunk)
    matrix, rng = random_matrix(0), np.random.default_rng(0)
    near = np.array([[0, 1, -1], [2, 3, 5], [4, 5, 6]])
    values = rng.normal(size=(3, 4, 3, FUNCTIONS)) * (near >= 0)[:, None, :, None]
    columns = (near[:, :, None] * FUNCTIONS + np.arange(FUNCTIONS)).reshape(3, -1)
    elements = Elements(*map(jnp.asarray, (values, columns, 3)))
    found = eqx.filter_jit(solver.covariances)(matrix, elements)
    whole = inverse(matrix).reshape(*SIZES, *SIZES)
    for e, own in enumerate(columns):
        own, v = own[own >= 0], values[e].reshape(4, -1)[:, own >= 0]
        expected = np.einsum("pu,uavb,pv->pab", v, whole[own][:, :, own], v)
        size = np.abs(expected).max()
        np.testing.assert_allclose(found[e], expected, atol=1e-9 * size)


def test_an_earlier_factor_is_found_again():
    """As `ModelCG` asks for it at every step."""
    matrix = random_matrix(7)
    solve(matrix, RIGHT)
    before = sparsax.factorization_count()
    solve(matrix, 2 * RIGHT)
    assert sparsax.factorization_count() == before


def test_devices_do_not_evict_factors_of_each_other():
    settings = {
        "JAX_NUM_CPU_DEVICES": "2",  # before any array is made
        "JAX_ENABLE_X64": "1",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    worker = subprocess.run(
        [sys.executable, str(WORKER)],
        env=os.environ | settings,
        capture_output=True,
        text=True,
    )
    assert worker.returncode == 0, worker.stderr
    _, devices, _, count, _, error = worker.stdout.split()
    assert int(devices) == 2
    assert int(count) == 4  # one a lane
    assert float(error) < 1e-8
