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
    import manireg as mr

    from .problems import PROBLEMS

    (name,), (K,) = options.problems, options.centres
    timed = Stopwatch()
    source, target, x, y, arguments, lam = PROBLEMS[name](K)

    problem, make, first = timed(mr.make_problem, source, target, x, y, **arguments)
    model, solve, second = timed(mr.solve, problem, lam)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    iteration, factorisation = _one_iteration(problem, model, timed)
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


def _one_iteration(problem, model, timed: Stopwatch) -> tuple[float, float]:
    """Seconds of value, gradient, Gauss-Newton matrix and its solve; and those of the
    factorisation with its solve alone. Best of two: CHOLMOD's analysis is done once."""
    import equinox as eqx
    import jax
    import lineax as lx
    import sparsax

    from manireg._hessian import gauss_newton
    from manireg._linear_solvers import SparseCholesky
    from manireg._minimise import GAUGE, stage_of
    from manireg._objective import objective

    stage = stage_of(
        problem, model.lam, GAUGE / problem.volume, "projected", model.coefficients
    )

    @eqx.filter_jit
    def step(w, stage):
        value = eqx.filter_value_and_grad(objective, has_aux=True)
        (total, _), gradient = value(w, stage)
        matrix = gauss_newton(w, stage)
        return total, lx.linear_solve(matrix, gradient, SparseCholesky()).value

    @eqx.filter_jit
    def system(w, stage):
        return SparseCholesky().init(gauss_newton(w, stage), {})

    # CHOLMOD's factor is kept while the values are the same: so they differ
    w = model.coefficients
    iteration = timed.shortest(step, [(w * (1 + 1e-6 * i), stage) for i in range(2)])
    i, j, values, _ = system(w, stage)
    factorise = jax.jit(sparsax.solve)
    side = values[: w.size]
    inputs = [(i, j, values * (1 + 1e-6 * n), side) for n in range(2)]
    return iteration, timed.shortest(factorise, inputs)
