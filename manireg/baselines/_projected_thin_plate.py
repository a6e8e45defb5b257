"""Smoothing in the ambient space, then projection onto N."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, PRNGKeyArray

from .._discretisation.local_polynomials import LocalPolynomials
from .._input.numbers import Numbers
from .._objective.arguments import argument, of_data
from .._objective.make_problem import make_problem
from .._objective.problem import Problem, psi_at_data
from .._programs.program import program
from .._selection.choice import evaluated
from .._selection.folds import held_out_error, training_sets
from .._selection.lambda_grid import lambda_grid
from .._solver.evaluation import evaluate
from .._solver.linear import AbstractSolvers, direct_solvers
from .._solver.starts import free_solution
from .._source import AbstractSource
from .._sources.checks import check_lam, check_lams
from ..manifolds import AbstractManifold
from ._inputs import check_choice, predicted


class ProjectedThinPlate(eqx.Module):
    """A thin-plate spline in the ambient space, projected onto the target on call."""

    source: AbstractSource
    target: AbstractManifold
    basis: LocalPolynomials
    origin: Float[Array, " t"]
    coefficients: Float[Array, "KC t"]
    lam: Float[Array, ""]
    lams: Float[Array, " lams"]
    """The grid `lam` was chosen from."""
    scores: Float[Array, "folds lams"]
    """(Weighted) mean geodesic error on each held-out fold; no folds if `lam`
    was given."""

    def ambient(self, x: Numbers) -> Float[Array, "..."]:
        """The spline itself, before the projection."""

        def values(flat):
            values, covered = evaluate(self.basis, self.coefficients, flat, self.origin)
            message = "x: some points lie outside the cover of the fitted map."
            return eqx.error_if(values, ~covered, message)

        return predicted(self, self.source, self.target, x, values)

    def __call__(self, x: Numbers) -> Float[Array, "..."]:
        """Values at `x`, `(n, *source.point_shape)` or a single point, on the target."""
        return self.target.project(self.ambient(x))


def projected_thin_plate(
    source: AbstractSource,
    target: AbstractManifold,
    x: Numbers,
    y: Numbers,
    lam: Numbers | None = None,
    *,
    lams: Numbers | None = None,
    folds: int | None = None,
    key: PRNGKeyArray | None = None,
    weights: Numbers | None = None,
    centres: int | None = None,
    degree: int = 2,
    width: float | None = None,
    linear_algebra: str = "auto",
) -> ProjectedThinPlate:
    r"""$\pi \circ f$, f the minimiser over all maps into the ambient $\mathbb{R}^t$ of

    $$\frac{\sum_i w_i |y_i - f(x_i)|^2}{\sum_i w_i} + \lambda \int_M |D^2 f|^2 .$$

    On an interval f is the cubic smoothing spline of each coordinate. It is also where
    `manireg.solve` starts. (Steinke and Hein 2008, the comparison of section 5; on a
    curved source, as there, affine maps of the ambient space cost nothing.)

    **Arguments:** as for `manireg.cross_validate`. With `lam` given nothing is
    cross-validated; without, lambda comes from `lams` or from `manireg.lambda_grid`
    (then widened past its edges), scored by the geodesic error of projected predictions.

    **Example:**

    ```python
    data = mr.datasets.polar_wander("india")  # 33 poles: ages, unit vectors
    model = mr.baselines.projected_thin_plate(
        mr.Interval(0, 320), mr.Sphere(2), data.ages, data.directions, 1e3
    )
    model(65.0)
    ```
    """
    check_choice(lam, lams, "lam")
    problem = make_problem(
        source,
        target,
        x,
        y,
        weights=weights,
        centres=centres,
        degree=degree,
        width=width,
    )
    solvers = direct_solvers(problem, linear_algebra)
    build = lambda lam, grid, scores: ProjectedThinPlate(
        source,
        target,
        problem.basis,
        problem.origin,
        _spline(argument(problem), lam, solvers),
        lam,
        grid,
        scores,
    )
    if lam is not None:
        lam = check_lam(lam)
        return build(lam, lam[None], jnp.zeros((0, 1)))
    training = of_data(training_sets(problem.weights, folds, key).T, len(problem.y)).T
    grid = lambda_grid(problem) if lams is None else jax.device_put(check_lams(lams))
    evaluate = lambda grid: (_scores(argument(problem), training, grid, solvers),)
    grid, (scores,), best = evaluated(grid, evaluate, widen=lams is None)
    return build(grid[best], grid, scores)


_spline = program(most=4)(free_solution)


@program(most=4)
def _scores(
    problem: Problem,
    training: Bool[ArrayLike, "folds k"],
    lams: Float[Array, " lams"],
    solvers: AbstractSolvers,
) -> Float[Array, "folds lams"]:
    def one(fold, lam):
        inside = eqx.tree_at(lambda p: p.weights, problem, problem.weights * fold)
        w = free_solution(inside, lam, solvers)
        values = psi_at_data(problem, w)
        shape = problem.target.point_shape
        predicted = problem.target.project(values.reshape(-1, *shape))
        return held_out_error(
            problem.target, predicted, problem.y, problem.weights, fold
        )

    return jax.lax.map(
        lambda fold: jax.lax.map(lambda lam: one(fold, lam), lams), training
    )
