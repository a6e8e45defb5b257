"""One run: a method on a data set; and the file of finished runs."""

import time
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from _table_file import read_rows

from manireg import datasets

from .methods import METHODS, TARGET

FIELDS = (
    *("convention", "k", "kappa", "rep", "method"),
    *("mean_error", "rms_error", "chosen", "seconds", "warm_seconds", "note"),
)
FIRST_SEED = 1000  # seeds that no test or notebook uses


class Task(NamedTuple):
    convention: str
    k: int
    kappa: float
    rep: int
    method: str


def make_data(convention: str, k: int, kappa: float, rep: int):
    key = jax.random.key(FIRST_SEED + rep)
    for number in (k, int(kappa)):
        key = jax.random.fold_in(key, number)
    return datasets.line_on_sphere(key, k, kappa, convention)


def run(task: Task) -> dict[str, object]:
    """Fit and test one method on one data set. Repetition 0 is fitted twice: the second
    time is without compilation."""
    data = make_data(*task[:4])
    row: dict[str, object] = task._asdict()
    try:
        times = []
        for _ in range(2 if task.rep == 0 else 1):
            start = time.perf_counter()
            fit = METHODS[task.method](data, task.rep)
            t = np.linspace(0, 1, 2001)
            predicted = np.asarray(fit.predict(t))
            times.append(time.perf_counter() - start)
        squared = np.asarray(TARGET.squared_distance(predicted, data.truth(t)))
    except Exception as error:  # a failed fit is a result: it is shown in the table
        return row | {"note": f"{type(error).__name__}: {str(error)[:120]!r}"}
    return row | {
        "mean_error": np.mean(np.sqrt(squared)),
        "rms_error": np.sqrt(np.mean(squared)),
        "chosen": fit.chosen,
        "seconds": times[0],
        "warm_seconds": times[1] if task.rep == 0 else "",
    }


def read_runs(path: Path) -> dict[Task, dict[str, str]]:
    """Finished runs; failed ones are left out, so they are tried again."""
    rows = [row for row in read_rows(path) if row["mean_error"]]
    return {task_of(row): row for row in rows}


def task_of(row) -> Task:
    k, kappa, rep = int(row["k"]), float(row["kappa"]), int(row["rep"])
    return Task(row["convention"], k, kappa, rep, row["method"])
