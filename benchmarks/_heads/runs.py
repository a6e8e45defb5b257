"""Runs of one method, a line each in a table that grows."""

import resource
import time
from argparse import Namespace
from pathlib import Path

import numpy as np
from _table_file import append_row, read_rows

FIELDS = (
    "data", "landmarks", "method", "target", "whole", "interior", "near_landmarks",
    "lam", "seconds", "peak_gb",
)  # fmt: skip
DATA = ("ict", "makehuman")
Key = tuple[str, int, str, int]


def read_runs(out: Path) -> dict[Key, dict[str, str]]:
    return {
        (r["data"], int(r["landmarks"]), r["method"], int(r["target"])): r
        for r in read_rows(out / "heads.csv")
    }


def run(options: Namespace) -> None:
    """The worker: one method on one file, target after target."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from .methods import METHODS

    (data,), (landmarks,), (method,) = options.data, options.landmarks, options.methods
    for target in options.targets:
        task = pair(data, target, landmarks)
        start = time.perf_counter()
        result = METHODS[method](task)
        seconds = time.perf_counter() - start
        vertices, lam = result if isinstance(result, tuple) else (result, None)
        errors = np.linalg.norm(vertices - task.truth, axis=1)
        if landmarks == 55 and data in DATA:
            for_pictures = options.out / "heads_vertices"
            for_pictures.mkdir(exist_ok=True)
            file = for_pictures / f"{data}_{method}_{target}.npy"
            np.save(file, vertices.astype(np.float32))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        row = {"data": data, "landmarks": landmarks, "method": method, "target": target}
        row |= {name: f"{value:.4f}" for name, value in scores(task, errors).items()}
        row |= {"lam": "" if lam is None else f"{lam:.4g}"}
        row |= {"seconds": f"{seconds:.1f}", "peak_gb": f"{peak:.2f}"}
        append_row(options.out / "heads.csv", FIELDS, row)


def pair(data: str, target: int, landmarks: int):
    """From the mean head, or for `..._pairs` from the head after the target."""
    from manireg.datasets import heads

    if data in DATA:
        return heads(data, target, landmarks)
    return heads(data.removesuffix("_pairs"), target, landmarks, source=target + 1)


def scores(task, errors: np.ndarray) -> dict[str, float]:
    """Means by area: over the whole head, the face's interior, and near landmarks."""
    everywhere = np.ones(len(errors), bool)
    parts = {
        "whole": everywhere,
        "interior": task.interior,
        "near_landmarks": task.near_landmarks,
    }
    return {
        name: float(np.average(errors[part], weights=task.area[part]))
        for name, part in parts.items()
    }
