"""Choice of lambda by cross-validation."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float, PRNGKeyArray

from ._checks import check_lam
from ._folds import GRID, evaluated, held_out_error, training_sets
from ._jets import values_at_data
from ._linear_solvers import direct_solvers
from ._minimise import minimise, newton_minimiser
from ._problem import Problem, make_problem
from ._progress import progress_bar, tick
from ._solve import RegressionMap, free_solution, solve
from ._sources import Source, sampled_dim
from .manifolds import AbstractManifold

COARSE = 1e-6  # relative decrease at which the fits of the folds stop


class CrossValidation(eqx.Module):
    """Scores of a grid of lambdas, the best one, and the map refitted with it."""

    lam: Float[Array, ""]
    """The lambda of the lowest mean score."""
    lams: Float[Array, " lams"]
    scores: Float[Array, "folds lams"]
    """(Weighted) mean geodesic error on each held-out fold."""
    converged: Bool[Array, "folds lams"]
    """Where Newton converged."""
    model: RegressionMap

    @property
    def score(self) -> Float[Array, ""]:
        """Mean score at the chosen lambda."""
        return jnp.mean(self.scores, axis=0)[jnp.argmin(jnp.abs(self.lams - self.lam))]


def lambda_grid(problem: Problem, n: int = GRID) -> Float[Array, " n"]:
    r"""Scale-free grid, equal steps of log lambda: lambda = (l / 2 pi)^4 / vol(M) for
    wavelengths l from the spacing of the data, (vol(M)/k)^{1/m}, to twice the size of M,
    vol(M)^{1/m}.

    A perturbation of wavelength l adds to loss and penalty alike at that lambda, whatever
    the scale of the target. Below the spacing the data say nothing.
    """
    size = problem.volume ** (1 / sampled_dim(problem.source))
    low = jnp.log(lambda_of_wavelength(problem, data_spacing(problem)))
    high = jnp.log(lambda_of_wavelength(problem, 2 * size))
    return jnp.exp(jnp.linspace(low, high, n))


def data_spacing(problem: Problem):
    return (problem.volume / len(problem.y)) ** (1 / sampled_dim(problem.source))


def lambda_of_wavelength(problem: Problem, wavelength):
    return (wavelength / (2 * np.pi)) ** 4 / problem.volume


def cross_validate(
    source: Source,
    target: AbstractManifold,
    x: ArrayLike,
    y: ArrayLike,
    lams: Sequence[float] | Float[Array, " lams"] | None = None,
    *,
    folds: int = 10,
    key: PRNGKeyArray | None = None,
    weights: ArrayLike | None = None,
    centres: int | None = None,
    degree: int | None = None,
    width: float | None = None,
    linear_algebra: str = "auto",
    max_steps: int = 25,
    progress: bool = True,
) -> CrossValidation:
    """Choose lambda by k-fold cross-validation and refit on all data.

    Folds are 0/1 weights, so all fits share one compiled program. Within a fold the
    lambdas are followed up and down from the one whose wavelength is the spacing of the
    data, each fit started from its neighbour: measured on curves, four Newton steps a fit
    where a cold start takes ten, and minima no worse. `max_steps` cuts fits short that
    fold up under a far too large lambda.

    **Arguments:**

    - `source`, `target`, `x`, `y`, `weights`, `centres`, `degree`, `width`: as in
      `make_problem`.
    - `lams`: the grid, positive; default `lambda_grid`, extended (at most twice)
      where the best value sits on an edge.
    - `folds`: default 10, at most the number of data.
    - `key`: for the random folds, default `jax.random.key(0)`.
    - `progress`: show a progress bar.
    """
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
    training = training_sets(len(problem.y), folds, key)
    everything = np.ones((1, len(problem.y)), dtype=bool)
    rows = jnp.asarray(np.concatenate([training, everything]))
    solvers = direct_solvers(linear_algebra, problem.basis.dim)

    def evaluate(grid):
        ticks = len(rows) * len(grid)
        with progress_bar(ticks, "cross-validation", progress) as bar:
            paths = _paths(problem, rows, grid, solvers, max_steps, bar)
            scores, w, converged = jax.block_until_ready(paths)
        return scores[:-1], w[-1:], converged[:-1]

    if lams is None:
        grid = lambda_grid(problem)
    else:
        check_lam(lams, "lams")
        grid = jnp.sort(jnp.asarray(lams, float).ravel())
    grid, paths, best = evaluated(grid, evaluate, widen=lams is None)
    scores, w, converged = paths
    model = solve(problem, grid[best], warm=w[0, best], linear_algebra=linear_algebra)
    return CrossValidation(grid[best], grid, scores, converged, model)


@eqx.filter_jit
def _paths(problem: Problem, training, lams, solvers, max_steps: int, bar):
    """For each row of `training` (0/1 weights) and each lambda: the held-out score, the
    coefficients, and whether Newton converged."""
    newton = newton_minimiser(solvers, COARSE)
    anchor = jnp.argmin(
        jnp.abs(jnp.log(lams / lambda_of_wavelength(problem, data_spacing(problem))))
    )
    position = jnp.arange(len(lams))
    upwards = position < len(lams) - anchor  # then on from the anchor, downwards
    order = jnp.where(upwards, anchor + position, len(lams) - 1 - position)

    def one_fold(inside):
        fold = eqx.tree_at(lambda p: p.weights, problem, problem.weights * inside)

        def step(carry, index):
            w, at_anchor = carry
            start = jnp.where(index == anchor - 1, at_anchor, w)
            w, _, _, result, _ = minimise(
                fold, lams[index], start, "projected", newton, max_steps
            )
            tick(bar)
            at_anchor = jnp.where(index == anchor, w, at_anchor)
            return (w, at_anchor), (w, result == optx.RESULTS.successful)

        start = free_solution(fold, lams[anchor], solvers)
        _, path = jax.lax.scan(step, (start, start), order)
        w, converged = jax.tree.map(lambda a: a[jnp.argsort(order)], path)
        return jax.vmap(lambda w: _score(problem, inside, w))(w), w, converged

    return jax.lax.map(one_fold, training)


def _score(problem: Problem, inside, w) -> Float[Array, ""]:
    """Held-out error; the last row holds nothing out and scores NaN."""
    values = values_at_data(problem.data_jets, w, len(problem.y))
    predicted = problem.target.project(values.reshape(-1, *problem.target.point_shape))
    return held_out_error(problem.target, predicted, problem.y, problem.weights, inside)
