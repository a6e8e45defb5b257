"""Runs of one method, a line each in a table that grows."""

import csv
import resource
import time
from argparse import Namespace
from pathlib import Path

import numpy as np

FIELDS = (
    "data", "landmarks", "method", "target", "whole", "interior", "near_landmarks",
    "lam", "seconds", "peak_gb",
)  # fmt: skip
Key = tuple[str, int, str, int]


def read_runs(out: Path) -> dict[Key, dict[str, str]]:
    path = out / "heads.csv"
    if not path.exists():
        return {}
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {
        (r["data"], int(r["landmarks"]), r["method"], int(r["target"])): r for r in rows
    }


def run(options: Namespace) -> None:
    """The worker: one method on one file, target after target."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from .data import Heads
    from .methods import METHODS

    (data,), (landmarks,), (method,) = options.data, options.landmarks, options.methods
    heads = Heads(data)
    for target in options.targets:
        start = time.perf_counter()
        result = METHODS[method](heads.task(target, landmarks))
        seconds = time.perf_counter() - start
        vertices, lam = result if isinstance(result, tuple) else (result, None)
        errors = heads.errors(target, vertices)
        if target == 0 or landmarks == 55:
            pictured = options.out / "heads_vertices"
            pictured.mkdir(exist_ok=True)
            file = pictured / f"{data}_{landmarks}_{method}_{target}.npy"
            np.save(file, vertices.astype(np.float32))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        row = {"data": data, "landmarks": landmarks, "method": method, "target": target}
        row |= {name: f"{value:.4f}" for name, value in heads.scores(errors).items()}
        row |= {"lam": "" if lam is None else f"{lam:.4g}"}
        row |= {"seconds": f"{seconds:.1f}", "peak_gb": f"{peak:.2f}"}
        path = options.out / "heads.csv"
        fresh = not path.exists()
        with path.open("a", newline="") as file:
            writer = csv.DictWriter(file, FIELDS)
            if fresh:
                writer.writeheader()
            writer.writerow(row)
