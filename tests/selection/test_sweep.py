"""Sweeps: lanes against a loop, on one device, on virtual ones, and in two processes."""

import socket
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import manireg as mr

WORKER = Path(__file__).with_name("_sweep_worker.py")


def start(devices: int, processes: int = 1, rank: int = 0, port: int = 0):
    arguments = map(str, (devices, processes, rank, port))
    return subprocess.Popen(
        [sys.executable, str(WORKER), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def differences(worker) -> list[float]:
    out, err = worker.communicate(timeout=600)
    assert worker.returncode == 0, err
    (line,) = (line for line in out.splitlines() if line.startswith("differences"))
    return [float(number) for number in line.split()[1:]]


def test_lanes_are_a_loop():
    lanes = jnp.arange(3.0), jnp.ones((3, 2))
    result = mr.sweep(lambda lane, shared: lane[0] * lane[1] + shared, lanes, 1.0)
    np.testing.assert_array_equal(result, [[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])


def test_lanes_of_different_length_are_refused():
    with pytest.raises(ValueError, match="one common leading axis"):
        mr.sweep(lambda lane, _: lane, (jnp.ones(3), jnp.ones(2)))
    with pytest.raises(ValueError, match="one common leading axis"):
        mr.sweep(lambda lane, _: lane, jnp.array(1.0))


@pytest.mark.slow
def test_virtual_devices():
    """Five lanes on four devices: shares are filled up."""
    sweep, folds = differences(start(devices=4))
    assert sweep < 1e-9
    assert folds < 1e-4


@pytest.mark.slow
def test_two_processes():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    workers = [start(2, 2, rank, port) for rank in range(2)]
    for worker in workers:
        sweep, folds = differences(worker)
        assert sweep < 1e-9
        assert folds < 1e-4
