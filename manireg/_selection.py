"""Choice of lambda by cross-validation."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float, Int, PRNGKeyArray
from tqdm.auto import tqdm

from ._checks import check_lam
from ._folds import GRID, evaluated, held_out_error, training_sets
from ._jets import values_at_data
from ._linear_solvers import direct_solvers
from ._minimise import minimise, newton_minimiser
from ._problem import Problem, make_problem
from ._solve import RegressionMap, free_solution, solve
from ._sources import Source, sampled_dim
from ._sweep import sweep
from .manifolds import AbstractManifold

COARSE = 1e-4  # predicted relative decrease of the last Newton step of a fold's fit
HOPELESS = 2.0  # a path ends where Newton fails and the score is so many times the best


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
        return jnp.mean(self.scores, axis=0)[self.chosen]

    @property
    def chosen(self) -> Int[Array, ""]:
        """Index of `lam` in `lams`."""
        return jnp.argmin(jnp.abs(self.lams - self.lam))


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

    Folds are 0/1 weights, so all fits share one compiled program, and several devices
    share the folds (see `sweep`). Within a fold the
    lambdas are followed up and down from the one whose wavelength is the spacing of the
    data, each fit started from its neighbours, extrapolated in log lambda: measured on
    curves, two Newton steps a fit, and minima no worse than from cold starts. Under a far
    too large lambda maps fold up and Newton's method struggles: a path ends where it has
    not converged in `max_steps` and the score is twice the fold's best; what lies beyond
    scores infinity.

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
    solvers = direct_solvers(linear_algebra, problem.basis.dim)

    def evaluate(grid):
        at_once = len(jax.devices())
        filled = np.arange(-(-folds // at_once) * at_once) % folds
        shared, paths = (problem, grid, solvers, max_steps), []
        with tqdm(total=folds, desc="folds", disable=not progress, leave=False) as bar:
            for lanes in np.split(filled, len(filled) // at_once):
                path = sweep(_path, training[lanes], shared)
                paths.append(jax.block_until_ready(path))
                bar.update(at_once)
        return jax.tree.map(lambda *parts: jnp.concatenate(parts)[:folds], *paths)

    if lams is None:
        grid = lambda_grid(problem)
    else:
        check_lam(lams, "lams")
        grid = jnp.sort(jnp.asarray(lams, float).ravel())
    grid, paths, best = evaluated(grid, evaluate, widen=lams is None)
    scores, w, converged = paths
    model = solve(problem, grid[best], warm=w[0, best], linear_algebra=linear_algebra)
    return CrossValidation(grid[best], grid, scores, converged, model)


class _Place(eqx.Module):
    """Where a path along log lambda has come to."""

    log_lam: Float[Array, ""]
    w: Float[Array, "KC t"]
    slope: Float[Array, "KC t"]
    """dw / d log lambda, from the last two fits."""
    best: Float[Array, ""]
    """Lowest score seen by either branch of the path."""
    ended: Bool[Array, ""]


def _path(inside: Bool[Array, " k"], shared):
    """Along all lambdas, fitted to the data `inside`: the score on the others, the
    coefficients, and whether Newton converged."""
    problem, lams, solvers, max_steps = shared
    fold = eqx.tree_at(lambda p: p.weights, problem, problem.weights * inside)
    newton = newton_minimiser(solvers, COARSE)
    log_lams = jnp.log(lams)
    spacing = lambda_of_wavelength(problem, data_spacing(problem))
    anchor = jnp.argmin(jnp.abs(log_lams - jnp.log(spacing)))
    position = jnp.arange(len(lams))
    upwards = position < len(lams) - anchor  # then on from the anchor, downwards
    order = jnp.where(upwards, anchor + position, len(lams) - 1 - position)

    def fit(place, index):
        gap = log_lams[index] - place.log_lam
        start = place.w + gap * place.slope
        w, _, _, result, _ = minimise(
            fold, lams[index], start, "projected", newton, max_steps
        )
        converged = result == optx.RESULTS.successful
        score = _score(problem, inside, w)
        secant = (w - place.w) / jnp.where(gap == 0, jnp.inf, gap)
        slope = jnp.where(converged, secant, 0.0)
        ended = ~converged & (score > HOPELESS * place.best)
        best = jnp.minimum(score, place.best)
        return _Place(log_lams[index], w, slope, best, ended), score, converged

    def visit(carry, index):
        place, at_anchor = carry
        back = eqx.tree_at(lambda p: p.best, at_anchor, place.best)
        place = _where(index == anchor - 1, back, place)
        skip = lambda: (place, jnp.full_like(place.best, jnp.inf), jnp.array(False))
        place, score, converged = jax.lax.cond(
            place.ended, skip, lambda: fit(place, index)
        )
        carry = place, _where(index == anchor, place, at_anchor)
        return carry, (score, place.w, converged)

    w = free_solution(fold, lams[anchor], solvers)
    nothing_yet = jnp.full_like(lams[0], jnp.inf), jnp.array(False)
    start = _Place(log_lams[anchor], w, jnp.zeros_like(w), *nothing_yet)
    _, path = jax.lax.scan(visit, (start, start), order)
    return jax.tree.map(lambda a: a[jnp.argsort(order)], path)


def _where(condition, a: _Place, b: _Place) -> _Place:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), a, b)


def _score(problem: Problem, inside, w) -> Float[Array, ""]:
    values = values_at_data(problem.data_jets, w, len(problem.y))
    predicted = problem.target.project(values.reshape(-1, *problem.target.point_shape))
    return held_out_error(problem.target, predicted, problem.y, problem.weights, inside)
