"""One run, a line in a table that grows."""

import resource
from argparse import Namespace
from pathlib import Path

from _table_file import append_row, read_rows
from _timing import Stopwatch

FIELDS = (
    "problem", "centres", "unknowns", "data", "make_problem", "solve", "compile",
    "newton_steps", "iteration", "factorisation", "peak_gb", "loss", "eells",
)  # fmt: skip
Key = tuple[str, int]


def read_runs(out: Path) -> dict[Key, dict[str, str]]:
    rows = read_rows(out / "large.csv")
    return {(row["problem"], int(row["centres"])): row for row in rows}


def run(options: Namespace) -> None:
    """The worker: one problem, one number of centres."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from _iteration import newton_iteration

    import manireg as mr
    from manireg._solver.minimise import gauge, stage_of

    from .problems import PROBLEMS

    (name,), (K,) = options.problems, options.centres
    timed = Stopwatch()
    source, target, x, y, arguments, lam = PROBLEMS[name](K)

    problem, make, first = timed(mr.make_problem, source, target, x, y, **arguments)
    model, solve, second = timed(mr.solve, problem, lam)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    w = model.coefficients
    stage = stage_of(problem, model.lam, gauge(problem), "projected", w)
    iteration, factorisation = newton_iteration(w, stage, repeats=1)
    row = {"problem": name, "centres": K, "unknowns": model.coefficients.size}
    row |= {
        "data": len(problem.y),
        "newton_steps": int(model.stats["num_newton_steps"]),
    }
    seconds = {"make_problem": make, "solve": solve, "compile": first + second}
    seconds |= {"iteration": iteration, "factorisation": factorisation}
    row |= {name: f"{value:.3g}" for name, value in seconds.items()}
    row |= {"peak_gb": f"{peak:.2f}"}
    row |= {name: repr(float(getattr(model.energies, name))) for name in FIELDS[-2:]}
    append_row(options.out / "large.csv", FIELDS, row)
