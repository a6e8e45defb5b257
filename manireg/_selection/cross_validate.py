"""Choice of lambda by k-fold cross-validation."""

import numpy as np
from jaxtyping import PRNGKeyArray

from .._input.numbers import Numbers
from .._objective.arguments import on_host
from .._objective.noise import check_scale
from .._objective.problem import Problem
from .._objective.robust import AbstractLoss
from .._objective.wavelengths import anchor
from .._source import AbstractSource
from .._sources.checks import check_lams
from ..manifolds import AbstractManifold
from .choice import CrossValidation, choose
from .folds import training_sets
from .k_fold import KFold
from .lambda_grid import lambda_grid
from .orders import Order, over_orders
from .path import up_and_down


def cross_validate(
    source: AbstractSource | Problem,
    target: AbstractManifold | Numbers | None = None,
    x: Numbers | None = None,
    y: Numbers | None = None,
    lams: Numbers | None = None,
    *,
    folds: int | None = None,
    key: PRNGKeyArray | None = None,
    weights: Numbers | None = None,
    centres: int | None = None,
    degree: int | None = None,
    width: float | None = None,
    graded: bool = False,
    tension: float = 0.0,
    sigma: Numbers | None = None,
    precision: Numbers | None = None,
    frames: Numbers | None = None,
    loss: AbstractLoss | str = "squared",
    order: Order = 2,
    linear_algebra: str = "auto",
    max_steps: int = 25,
    progress: bool = True,
) -> CrossValidation:
    """Choose lambda by k-fold cross-validation and refit on all data:
    `cross_validate(source, target, x, y, lams)` or `cross_validate(problem, lams)`.

    Folds are 0/1 weights, so all fits share one compiled program, and several devices
    share the folds (see `sweep`). The lambdas are followed up and down from the one whose
    wavelength is 1.5 spacings of the data, each fit started from its neighbours,
    extrapolated in log lambda: measured on curves, a few Newton steps a fit, and minima
    no worse than from cold starts. Under far too large lambdas a map followed from below
    folds up: where the mean score is twice the best, the default grid ends (what lies
    beyond scores infinity), and the rest of a given one is followed from its upper end
    downwards.

    **Arguments:**

    - `source`, `target`, `x`, `y`, `weights`, `centres`, `degree`, `width`, `graded`,
      `tension`: as in `make_problem`; or a `Problem` in place of them all.
    - `sigma`, `precision`, `frames`, `loss`: as in `make_problem`, as they are given.
    - `lams`: the grid, positive, in any order; equal ones are tried once. Default
      `lambda_grid`, extended (at most twice) where the best value sits on an edge.
    - `folds`: at most the number of data (of positive weight); default 10, or that number
      if it is smaller.
    - `key`: for the random folds, default `jax.random.key(0)`.
    - `order`: of the energy, or several to choose from, `(2, 3)`; `"auto"` is (2, 3, 4) as
      far as source and target allow. Each has a path of its own; the one whose criterion
      is lowest is returned (of those that ended in a minimum), with all in `paths`.
    - `linear_algebra`, `max_steps`: as in `solve`; the steps are those of a fold's fit.
    - `progress`: show a progress bar.

    **Raises** ValueError as `make_problem` does, for data beside a `Problem`, and for
    `lams` and `folds` that are not as above.

    **Example:**

    ```python
    data = mr.datasets.polar_wander("india")  # 33 poles: ages, unit vectors
    interval, sphere = mr.Interval(0, 320), mr.Sphere(2)
    cv = mr.cross_validate(
        interval, sphere, data.ages, data.directions, folds=5, progress=False
    )
    cv.lam, cv.score  # chosen, its error in radians
    ```
    """

    def of(problem: Problem, given: Numbers | None) -> CrossValidation:
        check_scale(problem.misfit)
        default = given is None
        training = training_sets(problem.weights, folds, key)
        grid = np.asarray(lambda_grid(problem)) if default else check_lams(given)
        middle = float(anchor(on_host(problem)))
        return choose(
            problem,
            KFold(problem, training, linear_algebra, max_steps),
            grid,
            lambda lams: up_and_down(lams, middle, to_the_end=not default),
            widen=default,
            progress=progress,
        )

    return over_orders(
        of,
        source,
        target,
        x,
        y,
        lams,
        order,
        weights=weights,
        centres=centres,
        degree=degree,
        width=width,
        graded=graded,
        tension=tension,
        sigma=sigma,
        precision=precision,
        frames=frames,
        loss=loss,
    )
