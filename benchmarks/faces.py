"""Faces with a known dense correspondence: landmarks alone, the whole surface, and
MeshMonk (White et al. 2019), scored on every vertex. One command runs what is missing and
writes the table anew:

    python benchmarks/faces.py

Face 0 of SIMPOP is the source, each of 1 to 14 a target, remeshed so that it shares no
vertex with the source. Each registered face is a line of `faces.csv` in `--out`, so the
command can be stopped and given again. Parameters of `surface=True` were found on faces 1
to 7; the table has 8 to 14 apart. The faces are found by `MANIREG_DATA`; remeshing takes
`pymeshlab`, MeshMonk `meshmonk` (`pip install 'manireg[faces]'`). Every method runs in a
process of its own; the first face of a run compiles and is done twice.
"""

import argparse

from _worker import add_options, run_missing

METHODS = ("rbf_r", "meshmonk", "landmarks", "surface")
TARGETS = range(1, 15)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    add = parser.add_argument
    add("--landmarks", nargs="+", type=int, default=(20, 5), choices=(20, 5))
    add("--methods", nargs="+", default=METHODS, choices=METHODS)
    add("--targets", nargs="+", type=int, default=TARGETS, choices=TARGETS)
    add_options(parser)
    return parser.parse_args()


def main() -> None:
    options = parse()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.worker:
        from _faces.runs import run

        run(options)
        return
    from _faces.report import write_report
    from _faces.runs import read_runs

    groups = [
        {"landmarks": n, "methods": method}
        for n in options.landmarks
        for method in options.methods
    ]
    run_missing(__file__, options.out, groups, lambda _: options.targets, read_runs)
    write_report(options.out)


if __name__ == "__main__":
    main()
