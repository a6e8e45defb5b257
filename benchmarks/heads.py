"""The second experiment of Steinke and Hein 2008 on open data: dense correspondence of
heads from landmarks, and from the whole target, scored against the known correspondence,
from the mean head and from one person onto another. One command runs what is
missing and writes table and pictures anew:

    python benchmarks/heads.py

Each registered head is a line of `heads.csv` in `--out`, so the command can be stopped and
given again. The heads are found by `MANIREG_DATA`. Every method runs in a process of its
own, so that its peak memory is seen; seconds include what a method compiles.
"""

import argparse

from _worker import add_options, run_missing

TARGETS = {
    "ict": range(10),
    "makehuman": range(10),
    "ict_pairs": (0, 2, 4),
    "makehuman_pairs": (0, 2, 4),
}
METHODS = (
    "affine", "rbf_r2logr", "rbf_r", "free_solution", "rkhs_warp", "nricp_sumner",
    "nricp_amberg", "meshmonk", "manireg_tension", "manireg_ambient", "manireg_intrinsic",
    "manireg_surface",
)  # fmt: skip


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    add = parser.add_argument
    add("--data", nargs="+", default=tuple(TARGETS), choices=TARGETS)
    add("--landmarks", nargs="+", type=int, default=(55, 20), choices=(55, 20))
    add("--methods", nargs="+", default=METHODS, choices=METHODS)
    add("--targets", nargs="+", type=int)
    add_options(parser)
    return parser.parse_args()


def main() -> None:
    options = parse()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.worker:
        from _heads.runs import run

        run(options)
        return
    from _heads.report import write_report
    from _heads.runs import read_runs

    groups = [
        {"data": data, "landmarks": landmarks, "methods": method}
        for landmarks in options.landmarks
        for data in options.data
        for method in options.methods
    ]
    targets = lambda group: options.targets or TARGETS[group["data"]]
    run_missing(__file__, options.out, groups, targets, read_runs)
    write_report(options.out)


if __name__ == "__main__":
    main()
