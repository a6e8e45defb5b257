"""One run: a method on a data set; and the file of finished runs."""

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from _table_file import read_rows

from .data import errors, make_data, mean
from .methods import METHODS

FIELDS = (
    *("shape", "landmarks", "seed", "method", "mean_error", "mean_along"),
    *("largest_error", "lam", "converged", "seconds", "note"),
)


class Task(NamedTuple):
    shape: str
    landmarks: int
    seed: int
    method: str

    def image_file(self, out: Path) -> Path:
        """Where the images of seed 0 are kept, for the pictures."""
        name = f"{self.shape}_{self.landmarks}_{self.method.replace(' ', '_')}.npy"
        return out / "bending_images" / name


def run(task: Task, centres: int, out: Path) -> dict[str, object]:
    row: dict[str, object] = task._asdict()
    data = make_data(*task[:3])
    start = time.perf_counter()
    try:
        fit = METHODS[task.method](data, centres)
    except Exception as error:  # a failed fit is a result: it is shown in the table
        return row | {"note": f"{type(error).__name__}: {str(error)[:120]!r}"}
    seconds = time.perf_counter() - start
    space, along = errors(data, fit.image)
    if task.seed == 0:
        task.image_file(out).parent.mkdir(exist_ok=True)
        np.save(task.image_file(out), fit.image.astype(np.float32))
    return row | {
        "mean_error": f"{mean(data, space):.6f}",
        "mean_along": f"{mean(data, along):.6f}",
        "largest_error": f"{space.max():.6f}",
        "lam": "" if np.isnan(fit.lam) else f"{fit.lam:.3g}",
        "converged": int(fit.converged),
        "seconds": f"{seconds:.1f}",
    }


def read_runs(path: Path) -> dict[Task, dict[str, str]]:
    """Finished runs; failed ones are left out, so they are tried again."""
    rows = [row for row in read_rows(path) if row["mean_error"]]
    return {
        Task(r["shape"], int(r["landmarks"]), int(r["seed"]), r["method"]): r
        for r in rows
    }
