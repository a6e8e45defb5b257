"""Isometric bending, where a volume spline cannot follow: a sheet onto a cylinder and
onto a roll of 1.5 turns, a bent tube onto a straight one, from 15 to 40 landmarks and a
noisy scan of the target. One command runs what is missing and writes table and pictures
anew:

    python benchmarks/bending.py

Each finished run is a line of `bending.csv` in `--out`, so the command can be stopped and
given again. Options narrow it down, e.g. `--shapes roll --landmarks 25 --seeds 1`.
"""

import argparse
import itertools
from pathlib import Path

from _table_file import append_row
from tqdm import tqdm


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    add = parser.add_argument
    add("--shapes", nargs="+", default=["roll", "tube", "cylinder"])
    add("--landmarks", nargs="+", type=int, default=[15, 25, 40])
    add("--seeds", type=int, default=3)
    add("--methods", nargs="+", help="default: all")
    add("--centres", type=int, default=100, help="local polynomials of our fits")
    add("--pictured", type=int, default=25, help="landmarks of the pictures")
    add("--out", type=Path, default=Path(__file__).parent / "results")
    return parser.parse_args()


def main() -> None:
    options = parse()
    import jax

    jax.config.update("jax_enable_x64", True)
    from _bending.methods import METHODS
    from _bending.pictures import write_picture
    from _bending.report import write_report
    from _bending.runs import FIELDS, Task, read_runs, run

    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "bending.csv"
    done = read_runs(path)
    # seeds outermost: a run that was stopped is balanced; methods innermost share data
    cells = itertools.product(
        range(options.seeds),
        options.landmarks,
        options.shapes,
        options.methods or METHODS,
    )
    tasks = [Task(shape, k, seed, method) for seed, k, shape, method in cells]
    missing = [task for task in tasks if task not in done]
    bar = tqdm(missing, unit="run")
    for task in bar:
        bar.set_postfix_str(" ".join(map(str, task)))
        append_row(path, FIELDS, run(task, options.centres, options.out))
        jax.clear_caches()  # data sets share no program, but programs fill memory
    runs = read_runs(path)
    write_report(options.out / "bending.md", runs, set(tasks))
    for shape in options.shapes:
        write_picture(options.out, shape, options.pictured)


if __name__ == "__main__":
    main()
