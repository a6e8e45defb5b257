"""Runs of one method, a line each in a table that grows."""

import resource
import warnings
from argparse import Namespace
from pathlib import Path

import numpy as np
from _table_file import append_row, read_rows

FIELDS = (
    "landmarks", "method", "target", "predicted", "fitted", "lam", "folds", "seconds",
    "peak_gb",
)  # fmt: skip
Key = tuple[int, str, str]


def read_runs(out: Path) -> dict[Key, dict[str, str]]:
    return {
        (int(r["landmarks"]), r["method"], r["target"]): r
        for r in read_rows(out / "skulls.csv")
    }


def run(options: Namespace) -> None:
    """The worker: one method, target after target."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from _timing import Stopwatch

    from .methods import METHODS
    from .tasks import skull

    # landmarks off the surface, edges of three triangles: known of these files
    warnings.filterwarnings("ignore", category=UserWarning)
    watch = Stopwatch()
    (landmarks,), (method,) = options.landmarks, options.methods
    for target in options.targets:
        task = skull(target, landmarks)
        image, seconds, _ = watch(METHODS[method], task)
        errors = np.linalg.norm(image.landmarks - task.target_landmarks, axis=1)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        row = {"landmarks": landmarks, "method": method, "target": target}
        row |= {"predicted": f"{errors[~task.fitted].mean():.4f}"}
        row |= {"fitted": f"{errors[task.fitted].mean():.4f}"}
        row |= {"lam": "" if image.lam is None else f"{image.lam:.4g}"}
        row |= {"folds": f"{folded(image.vertices, task):.5f}"}
        row |= {"seconds": f"{seconds:.1f}", "peak_gb": f"{peak:.2f}"}
        append_row(options.out / "skulls.csv", FIELDS, row)


def folded(vertices: np.ndarray, task) -> float:
    """Share of the triangles that are turned away from the target where they are."""
    from manireg._surfaces.folds import agreement

    triangles = np.asarray(task.source.cloud.triangles)
    return float(np.mean(agreement(vertices, triangles, task.target.cloud) < 0))
