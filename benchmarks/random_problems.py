"""Ten thousand random regressions: does Newton end at a minimum, and does it say so when
it does not?

Targets x sources x lambda over 12 decades x numbers of data, each a random smooth map with
noise from none to more than the map. What a fit says of itself is checked independently:
the gradient, in units of what rounding leaves, and the smallest eigenvalue of the exact
Hessian, both dense. `python benchmarks/random_problems.py --problems 10000` takes hours;
`--problems 300` is a sample, `--shapes` picks some of the 29 programs. Every problem is a
line of `results/random_problems.csv` as it is done; `.md` has the shares.
"""

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pandas as pd
import scipy.linalg as sl

import manireg as mr
from manireg._objective.hessian import exact
from manireg._objective.objective import objective
from manireg._objective.wavelengths import anchor
from manireg._solver.minimise import gauge, stage_of

SOURCES = {
    "interval": mr.Interval(0.0, 1.0),
    "circle": mr.Sphere(1),
    "sphere": mr.Sphere(2),
    "box": mr.Box((0.0, 0.0), (1.0, 2.0)),
}
TARGETS = {
    "line": mr.Euclidean(1),
    "circle": mr.Sphere(1),
    "sphere": mr.Sphere(2),
    "rotations": mr.SpecialOrthogonal(3),
    "cylinder": mr.Cylinder(),
    "torus": mr.FlatTorus(2),
    "poses": mr.Product(mr.SpecialOrthogonal(3), mr.Euclidean(3)),
    "shapes": mr.PlanarShapes([[0.0, 0.0], [1.0, 0.1], [0.4, 0.9]]),
    "spd": mr.SymmetricPositiveDefinite(2),
    "big sphere": mr.Sphere(2, radius=1e3),
}
SIZES = (3, 5, 10, 30, 100, 300)
# (source, target, k): each a compiled program
SHAPES = (
    [("interval", target, k) for target in ("sphere",) for k in SIZES]
    + [("interval", target, 30) for target in TARGETS if target != "sphere"]
    + [("interval", target, 100) for target in ("rotations", "poses", "circle")]
    + [("circle", target, k) for target in ("circle", "sphere") for k in (5, 30, 100)]
    + [("circle", "rotations", 30), ("box", "line", 30), ("sphere", "circle", 30)]
    + [("sphere", "sphere", 30), ("box", "sphere", 30)]
)
DECADES = 12
RIDGE, CURVED = 1e-9, 1e-7  # of a Hessian with ones on its diagonal
COLUMNS = ("source", "target", "k", "log10_lam", "noise", "part", "success", "steps")
MORE = ("objective", "gradient", "curvature")


def problem_of(rng, source: str, target: str, k: int):
    """Data of a random smooth map into N, with random noise, all over the source or on
    a part of it."""
    M, N = SOURCES[source], TARGETS[target]
    part = rng.choice([1.0, 0.5]) if source == "interval" else 1.0
    if source == "interval":
        x = part * rng.uniform(size=k)
    elif source == "box":
        x = rng.uniform((0, 0), (1, 2), (k, 2))
    else:
        x = np.array(M.random_points(jax.random.key(rng.integers(2**31)), k))
    t = int(np.prod(N.point_shape))
    z = x.reshape(k, -1)
    waves = rng.normal(size=(3, z.shape[1])) * rng.choice([1.0, 4.0, 12.0])
    phases = z @ waves.T + rng.uniform(0, 2 * np.pi, 3)
    size = float(np.minimum(np.asarray(N.reach), 1e3)) if np.isfinite(N.reach) else 1.0
    smooth = np.cos(phases) @ rng.normal(size=(3, t)) + rng.normal(size=t)
    noise = rng.choice([0.0, 0.01, 0.3, 3.0])
    y = size * (smooth + noise * rng.normal(size=(k, t)))
    y = np.array(N.project(jnp.asarray(y).reshape(k, *N.point_shape)))
    problem = mr.make_problem(M, N, x, y)
    return problem, float(np.log10(anchor(problem))), noise, part


@eqx.filter_jit
def evidence(problem, lam, w):
    stage = stage_of(problem, lam, gauge(problem), "projected", w)
    f, gradient = jax.value_and_grad(lambda w: objective(w, stage)[0])(w)
    return f, gradient.ravel(), exact(w, stage).as_matrix()


def checked(problem, lam, model) -> tuple[float, float, float]:
    """Objective; decrease a Newton step promises, relative to it; smallest eigenvalue of
    the Hessian, its diagonal scaled to one (0 where it is no less than -CURVED)."""
    f, gradient, hessian = map(np.array, evidence(problem, lam, model.coefficients))
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-14 * np.diag(hessian).max()))
    scaled, gradient = hessian / scale[:, None] / scale, gradient / scale
    one = np.eye(len(scale))
    try:
        step = sl.cho_solve(sl.cho_factor(scaled + RIDGE * one), gradient)
        sl.cholesky(scaled + CURVED * one)
        smallest = 0.0
    except (np.linalg.LinAlgError, ValueError):
        values, vectors = np.linalg.eigh(scaled)
        step = vectors @ ((vectors.T @ gradient) / np.maximum(np.abs(values), RIDGE))
        smallest = values[0]
    size = float(np.mean(np.sum(np.asarray(problem.y - problem.origin) ** 2, axis=1)))
    return float(f), float(0.5 * gradient @ step) / max(f, 1e-20 * size), smallest


def main():
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--shapes", type=int, nargs="*")
    results = Path(__file__).parent / "results" / "random_problems.csv"
    parser.add_argument("--out", type=Path, default=results)
    options = parser.parse_args()
    numbers = options.shapes or range(len(SHAPES))
    each = -(-options.problems // len(SHAPES))
    file = options.out.open("w", newline="", buffering=1)  # a long run, kept as it goes
    table = csv.writer(file)
    table.writerow((*COLUMNS, *MORE))
    for number in numbers:
        source, target, k = SHAPES[number]
        rng = np.random.default_rng((options.seed, number))
        for _ in range(each):
            problem, middle, noise, part = problem_of(rng, source, target, k)
            decade = rng.uniform(middle - DECADES / 2, middle + DECADES / 2)
            lam = 10.0**decade
            model = mr.solve(problem, lam, throw=False)
            success = bool(model.result == optx.RESULTS.successful)
            f, gradient, curvature = checked(problem, jnp.asarray(lam), model)
            row = (source, target, k, round(decade - middle, 2), noise, part, success)
            steps = int(model.stats["num_steps"])
            table.writerow((*row, steps, f, gradient, curvature))
    file.close()
    print(write_report([options.out], options.out.with_suffix(".md")))


def write_report(tables: Sequence[Path], report: Path) -> str:
    """What was found in all tables (of several processes, say)."""
    found = pd.concat(map(pd.read_csv, tables))
    found["failed"] = 100.0 * ~found["success"]
    found["false"] = is_false(found)
    parts = [
        f"{len(found)} random problems, {found['false'].sum()} false successes, "
        f"{found['failed'].mean():.1f} % failed; steps: median "
        f"{found['steps'].median():.0f}, 99 % {found['steps'].quantile(0.99):.0f}."
    ]
    for name in ("noise", "k", "target", "source"):
        by = found.groupby(name)
        table = pd.DataFrame(
            {
                "problems": by.size(),
                "false": by["false"].sum(),
                "failed, %": by["failed"].mean().round(1),
                "steps, median": by["steps"].median().astype(int),
            }
        )
        rows = [
            f"| {label} | {' | '.join(map(str, row))} |"
            for label, *row in table.astype(object).itertuples()
        ]
        head = [name, *table.columns]
        parts.append(
            "\n".join([f"| {' | '.join(head)} |", "|" + " --- |" * len(head), *rows])
        )
    text = "\n\n".join(parts) + "\n"
    report.write_text(text)
    return text


def is_false(found: pd.DataFrame) -> pd.Series:
    """Success, but a Newton step still promises a millionth, or the Hessian bends down."""
    wrong = (found["gradient"] > 1e-6) | (found["curvature"] < -CURVED)
    return found["success"] & wrong


if __name__ == "__main__":
    main()
