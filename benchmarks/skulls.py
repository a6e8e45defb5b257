"""Mouse skulls with hand-set landmarks: landmarks alone, the whole surface, MeshMonk
(White et al. 2019) and coherent point drift (pycpd), scored on the landmarks they were not
given. One command runs what is missing and writes the table anew:

    python benchmarks/skulls.py

The skull of strain A_J is the source, those of five others the targets: micro-CT as it is,
60,000 to 98,000 vertices in 47 to 114 components, with 51 landmarks, of which 36 or 13 are
fitted and the other 15 or 38 predicted. Each registered skull is a line of `skulls.csv` in
`--out`, so the command can be stopped and given again. The skulls are found by
`MANIREG_DATA`; MeshMonk takes `meshmonk`, point drift `pycpd` (`pip install
'manireg[faces]'`). Every method runs in a process of its own; seconds leave out what JAX
compiles, and the reading of files.
"""

import argparse

from _worker import add_options, run_missing

METHODS = ("rbf_r", "meshmonk_rigid", "meshmonk_warp", "drift", "landmarks", "surface")
TARGETS = ("C57BL6_J", "CAST_EIJ", "DBA_2J", "NZO", "WSB")


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    add = parser.add_argument
    add("--landmarks", nargs="+", type=int, default=(36, 13), choices=(36, 13))
    add("--methods", nargs="+", default=METHODS, choices=METHODS)
    add("--targets", nargs="+", default=TARGETS, choices=TARGETS)
    add_options(parser)
    return parser.parse_args()


def main() -> None:
    options = parse()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.worker:
        from _skulls.runs import run

        run(options)
        return
    from _skulls.report import write_report
    from _skulls.runs import read_runs

    groups = [
        {"landmarks": n, "methods": method}
        for n in options.landmarks
        for method in options.methods
    ]
    run_missing(__file__, options.out, groups, lambda _: options.targets, read_runs)
    write_report(options.out)


if __name__ == "__main__":
    main()
