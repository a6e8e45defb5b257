"""Time and memory of one regression between surfaces as the number of centres grows. One
command runs what is missing and writes the table anew:

    python benchmarks/large.py

Each run is a line of `large.csv` in `--out`, so the command can be stopped and given
again, and has a process of its own, so that its peak memory is seen. Seconds are those of
warm programs; what JAX spends on tracing and compiling is in a column of its own.
"""

import argparse
import itertools

from _worker import add_options, start_worker
from tqdm import tqdm

CENTRES = (250, 400, 1000, 4000)
LARGEST = {"sphere2": 1000}  # its factor alone takes 9 GB at 4,000


def parse() -> argparse.Namespace:
    from _large.problems import PROBLEMS

    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    add = parser.add_argument
    add("--problems", nargs="+", default=list(PROBLEMS), choices=list(PROBLEMS))
    add("--centres", nargs="+", type=int, default=CENTRES)
    add_options(parser)
    return parser.parse_args()


def main() -> None:
    options = parse()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.worker:
        from _large.runs import run

        run(options)
        return
    from _large.report import write_report
    from _large.runs import read_runs

    cells = itertools.product(options.centres, options.problems)
    runs = [(name, K) for K, name in cells if K <= LARGEST.get(name, K)]
    with tqdm(runs, unit="run") as bar:
        for name, K in bar:
            bar.set_postfix_str(f"{name}, {K} centres")
            if (name, K) not in read_runs(options.out):
                start_worker(__file__, options.out, problems=[name], centres=[K])
                write_report(options.out)
    write_report(options.out)


if __name__ == "__main__":
    main()
