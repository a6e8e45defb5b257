"""The first experiment of Steinke and Hein 2008 (Figure 2): a curve on the sphere from
noisy samples. One command runs what is missing and writes table and pictures anew:

    python benchmarks/line_on_sphere.py

Each finished run is a line of `line_on_sphere.csv` in `--out`, so the command can be
stopped and given again. Options narrow it down, e.g. `--ks 70 --kappas 10000 --reps 3`.
"""

import argparse
import itertools
import multiprocessing
import os
from pathlib import Path

from _table_file import append_row
from tqdm import tqdm


def single_threaded() -> None:
    """For this process and those it starts, before they import JAX."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    flags = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flags}".strip()
    os.environ["JAX_PLATFORMS"] = "cpu"


def start_worker() -> None:
    import jax

    jax.config.update("jax_enable_x64", True)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    add = parser.add_argument
    add("--conventions", nargs="+", default=["polar", "azimuth"])
    add("--ks", nargs="+", type=int, default=[30, 70, 200, 500])
    add("--kappas", nargs="+", type=float, default=[100, 1000, 10000])
    add("--reps", type=int, default=10)
    add("--out", type=Path, default=Path(__file__).parent / "results")
    add("--jobs", type=int, default=1, help="processes, each with one thread")
    return parser.parse_args()


def main() -> None:
    options = parse()
    single_threaded()
    from _line_on_sphere.report import write_report
    from _line_on_sphere.runs import FIELDS, METHODS, Task, read_runs, run

    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "line_on_sphere.csv"
    done = read_runs(path)
    # repetitions outermost: a run that was stopped is balanced
    cells = itertools.product(
        range(options.reps), options.conventions, options.ks, options.kappas, METHODS
    )
    tasks = [Task(c, k, kappa, rep, m) for rep, c, k, kappa, m in cells]
    missing = [task for task in tasks if task not in done]

    spawn = multiprocessing.get_context("spawn")
    pool = spawn.Pool(options.jobs, start_worker)
    bar = tqdm(total=len(tasks), initial=len(tasks) - len(missing), unit="run")
    with pool, bar:
        for row in pool.imap_unordered(run, missing):
            append_row(path, FIELDS, row)
            bar.set_postfix_str(
                "{convention} k={k} kappa={kappa:g} {method}".format(**row)
            )
            bar.update()
        pool.close()
        pool.join()

    start_worker()
    write_report(options.out, read_runs(path), set(tasks))


if __name__ == "__main__":
    main()
