"""Choice of lambda by cross-validation."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float, PRNGKeyArray

from ._checks import check_lam
from ._densities import geodesic_loss
from ._jets import jet_values
from ._linear_solvers import direct_solvers
from ._problem import Problem, make_problem
from ._progress import progress_bar, tick
from ._solve import (
    RegressionMap,
    free_solution,
    minimise,
    newton_minimiser,
    solve,
)
from ._sources import Source
from .manifolds import AbstractManifold

GRID = 20
WIDENINGS = 2  # times the default grid may be extended past an edge
COARSE = 1e-6  # relative decrease at which the fits of the folds stop


class CrossValidation(eqx.Module):
    """Scores of a grid of lambdas, the best one, and the map refitted with it."""

    lam: Float[Array, ""]
    """The lambda of the lowest mean score."""
    lams: Float[Array, " lams"]
    scores: Float[Array, "folds lams"]
    """(Weighted) mean geodesic error on each held-out fold: not squared, so that one datum
    in a gap, far off whatever lambda is, does not decide alone."""
    converged: Bool[Array, "folds lams"]
    """Where Newton converged."""
    model: RegressionMap

    @property
    def score(self) -> Float[Array, ""]:
        """Mean score at the chosen lambda."""
        return jnp.min(jnp.mean(self.scores, axis=0))


def lambda_grid(problem: Problem, n: int = GRID) -> Float[Array, " n"]:
    r"""Scale-free grid, equal steps of log lambda: lambda = (l / 2 pi)^4 / vol(M) for
    wavelengths l from the spacing of the data, (vol(M)/k)^{1/m}, to twice the size of M,
    vol(M)^{1/m}.

    A perturbation of wavelength l adds to loss and penalty alike at that lambda, whatever
    the scale of the target. Below the spacing the data say nothing.
    """
    size = problem.volume ** (1 / problem.basis.dim)
    low = jnp.log(_lambda_of_wavelength(problem, _spacing(problem)))
    high = jnp.log(_lambda_of_wavelength(problem, 2 * size))
    return jnp.exp(jnp.linspace(low, high, n))


def _spacing(problem: Problem):
    return (problem.volume / len(problem.y)) ** (1 / problem.basis.dim)


def _lambda_of_wavelength(problem: Problem, wavelength):
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
    degree: int = 2,
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
    k = len(problem.y)
    if not 2 <= folds <= k:
        raise ValueError(f"folds: must lie between 2 and the number of data, {k}.")
    key = jax.random.key(0) if key is None else key
    fold_of = np.asarray(jax.random.permutation(key, k)) % folds
    training = np.concatenate(
        [fold_of[None, :] != np.arange(folds)[:, None], np.ones((1, k), bool)]
    )
    solvers = direct_solvers(linear_algebra)

    def scores_of(lams):
        with progress_bar(
            len(training) * len(lams), "cross-validation", progress
        ) as bar:
            return jax.block_until_ready(
                _paths(problem, jnp.asarray(training), lams, solvers, max_steps, bar)
            )

    if lams is None:
        grid, paths = _widening(lambda_grid(problem), scores_of)
    else:
        check_lam(lams, "lams")
        grid = jnp.sort(jnp.asarray(lams, float).ravel())
        paths = scores_of(grid)
    scores, w, converged = paths
    best = int(jnp.argmin(jnp.mean(scores[:folds], axis=0)))
    model = solve(problem, grid[best], warm=w[-1, best], linear_algebra=linear_algebra)
    return CrossValidation(grid[best], grid, scores[:folds], converged[:folds], model)


def _widening(lams, scores_of):
    """While the best score sits on an edge, extend the grid past it, by a quarter of its
    range (as many values as before: the compiled program is used again)."""
    paths = scores_of(lams)
    ratios = (lams[-1] / lams[0]) ** (0.25 * jnp.arange(1, len(lams) + 1) / len(lams))
    for _ in range(WIDENINGS):
        means = jnp.mean(paths[0][:-1], axis=0)
        best = int(jnp.argmin(means))
        if 0 < best < len(means) - 1:
            break
        below = best == 0
        new = lams[0] / ratios[::-1] if below else lams[-1] * ratios
        join = lambda old, new: jnp.concatenate(
            [new, old] if below else [old, new], axis=old.ndim > 1
        )
        lams, paths = jax.tree.map(join, (lams, paths), (new, scores_of(new)))
    return lams, paths


@eqx.filter_jit
def _paths(problem: Problem, training, lams, solvers, max_steps: int, bar):
    """For each row of `training` (0/1 weights) and each lambda: the held-out score, the
    coefficients, and whether Newton converged."""
    newton = newton_minimiser(solvers, COARSE)
    anchor = jnp.argmin(
        jnp.abs(jnp.log(lams / _lambda_of_wavelength(problem, _spacing(problem))))
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
        return jax.vmap(lambda w: _held_out(problem, inside, w))(w), w, converged

    return jax.lax.map(one_fold, training)


def _held_out(problem: Problem, inside, w) -> Float[Array, ""]:
    """Weighted mean geodesic error on the data outside the training set."""
    jets = problem.data_jets
    values = jet_values(jets, w)[:, :, 0]
    error = lambda psi, y: jnp.sqrt(geodesic_loss(problem.target, psi, y))
    errors = jax.vmap(jax.vmap(error))(values, problem.y[jets.index])
    held_out = (problem.weights * ~inside)[jets.index] * jets.mask
    return jnp.sum(held_out * errors) / jnp.sum(held_out)
