"""Choice of lambda by cross-validation."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray
from tqdm.auto import tqdm

from .._input.numbers import Numbers
from .._input.precision import check_x64
from .._objective.objective import objective
from .._objective.problem import Problem, make_problem, psi_at_data
from .._objective.wavelengths import anchor, lambda_of_wavelength, mean_spacing
from .._solver.linear import direct_solvers
from .._solver.minimise import gauge, minimise, newton_minimiser, stage_of
from .._solver.solve import RegressionMap, solve
from .._solver.starts import starts_of
from .._sources.checks import check_lams
from .._sources.sources import Source, sampled_dim
from ..manifolds import AbstractManifold
from .folds import GRID, evaluated, held_out_error, training_sets
from .sweep import sweep

# Predicted relative decrease of the last Newton step of a fold's fit. 3e-3 saves a fifth
# of the time; measured on curves, errors that change mostly grow by 1 to 3 %.
COARSE = 1e-3
HOPELESS = 2.0  # times the best mean score


class CrossValidation(eqx.Module):
    """Scores of a grid of lambdas, the best one, and the map refitted with it."""

    lam: Float[Array, ""]
    """`cross_validate`: of the lowest mean score; `leave_one_out`: the largest within one
    standard error of it."""
    lams: Float[Array, " lams"]
    scores: Float[Array, "folds lams"]
    """(Weighted) mean geodesic error on each held-out fold; infinite where not tried. Of
    `leave_one_out` a row for each datum of positive weight."""
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


def lambda_grid(problem: Problem, n: int | None = None) -> Float[Array, " n"]:
    r"""Scale-free grid, equal steps of log lambda: lambda = (l / 2 pi)^4 / V for
    wavelengths l from the spacing of the data, (V/k)^{1/m}, to twice the size of M,
    vol(M)^{1/m}. V is the volume that the data fill: vol(M), or where they cluster (see
    `centres` in `make_problem`) k times that of their median spacing.

    `n` defaults to 20, or where the data cluster to as many as take the same steps.

    A perturbation of wavelength l adds to loss and penalty alike at that lambda, whatever
    the scale of the target. Below the spacing the data say nothing.
    """
    check_x64(problem)
    size = problem.volume ** (1 / sampled_dim(problem.source))
    low = jnp.log(lambda_of_wavelength(problem, mean_spacing(problem)))
    high = jnp.log(lambda_of_wavelength(problem, 2 * size))
    if n is None:
        even = 4 * (np.log(2) + np.log(len(problem.y)) / sampled_dim(problem.source))
        n = 1 + round((GRID - 1) * max(1.0, float(high - low) / even))
    return jnp.exp(jnp.linspace(low, high, n))


def cross_validate(
    source: Source,
    target: AbstractManifold,
    x: Numbers,
    y: Numbers,
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
    linear_algebra: str = "auto",
    max_steps: int = 25,
    progress: bool = True,
) -> CrossValidation:
    """Choose lambda by k-fold cross-validation and refit on all data.

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
      `tension`: as in `make_problem`.
    - `lams`: the grid, positive, in any order; equal ones are tried once. Default
      `lambda_grid`, extended (at most twice) where the best value sits on an edge.
    - `folds`: at most the number of data (of positive weight); default 10, or that number
      if it is smaller.
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
        graded=graded,
        tension=tension,
    )
    training = training_sets(problem.weights, folds, key)
    solvers = direct_solvers(linear_algebra, problem.basis.dim)

    def evaluate(grid):
        with tqdm(total=len(grid), desc="lambdas", disable=not progress) as bar:
            shared = problem, solvers, max_steps
            return _follow(grid, shared, training, bar, adapt=lams is None)

    grid = lambda_grid(problem) if lams is None else jnp.asarray(check_lams(lams))
    grid, paths, best = evaluated(grid, evaluate, widen=lams is None)
    scores, converged, w = paths
    warm = _lowest(w[:, best], problem, grid[best])
    model = solve(problem, grid[best], warm=warm, linear_algebra=linear_algebra)
    return CrossValidation(grid[best], grid, scores, converged, model)


def _follow(grid, shared, training, bar, adapt: bool):
    """Scores and convergence, `(folds, lams)`; coefficients, `(folds, lams, KC, t)`.
    `adapt`: no further than to the hopeless."""
    problem, n = shared[0], len(grid)
    middle = int(jnp.argmin(jnp.abs(jnp.log(grid / anchor(problem)))))
    scores = np.full((len(training), n), np.inf)
    converged = np.zeros((len(training), n), dtype=bool)
    w = np.zeros((len(training), n, problem.pattern.size, problem.y.shape[1]))

    def start(i):
        return sweep(_start, training, (grid[i], *shared))

    def fit(place, i):
        lanes = training, place
        place, scores[:, i], converged[:, i] = sweep(
            _advance, lanes, (grid[i], *shared)
        )
        w[:, i] = place.w
        bar.update()
        return place

    def follow(place, indices: range, to_the_end: bool) -> range:
        """From place to place, up to the first hopeless one; what is left."""
        for done, i in enumerate(indices, start=1):
            place = fit(place, i)
            means = scores.mean(axis=0)
            if means[i] > HOPELESS * means.min() and not to_the_end:
                return indices[done:]
        return indices[:0]

    at_anchor = fit(start(middle), middle)
    beyond = follow(at_anchor, range(middle + 1, n), to_the_end=False)
    follow(at_anchor, range(middle - 1, -1, -1), to_the_end=not adapt)
    if beyond and not adapt:
        follow(start(n - 1), beyond[::-1], to_the_end=True)
    return tuple(map(jnp.asarray, (scores, converged, w)))


class _Place(eqx.Module):
    """Where a path along log lambda has come to."""

    log_lam: Float[Array, ""]
    w: Float[Array, "KC t"]
    slope: Float[Array, "KC t"]
    """dw / d log lambda, from the last two fits."""


def _start(inside: Bool[Array, " k"], shared) -> _Place:
    lam, problem, solvers, _ = shared
    fold = _fold(problem, inside)
    w = starts_of(fold, lam, (1.0,), "projected", solvers)[0][0]
    return _Place(jnp.log(lam), w, jnp.zeros_like(w))


def _advance(lane, shared):
    """On to the next lambda: the place, its score on the data not `inside`, and whether
    Newton converged."""
    (inside, place), (lam, problem, solvers, max_steps) = lane, shared
    newton = newton_minimiser(solvers, COARSE)
    gap = jnp.log(lam) - place.log_lam
    start = place.w + gap * place.slope
    fold = _fold(problem, inside)
    found = minimise(fold, lam, start, "projected", newton, max_steps)
    converged = found.result == optx.RESULTS.successful
    # a fit that ends in no numbers is no start for the next
    w = jnp.where(jnp.all(jnp.isfinite(found.w)), found.w, place.w)
    secant = (w - place.w) / jnp.where(gap == 0, jnp.inf, gap)
    slope = jnp.where(converged, secant, 0.0)
    place = _Place(jnp.log(lam), w, slope)
    score = jnp.nan_to_num(_score(problem, inside, w), nan=jnp.inf)
    return place, score, converged


def _fold(problem: Problem, inside) -> Problem:
    return eqx.tree_at(lambda p: p.weights, problem, problem.weights * inside)


@eqx.filter_jit
def _lowest(w: Float[Array, "folds KC t"], problem: Problem, lam):
    """The map of lowest objective on all data: folds may lie in different minima."""

    def total(w):
        stage = stage_of(problem, lam, gauge(problem), "projected", w)
        return objective(w, stage)[0]

    totals = jnp.nan_to_num(jax.lax.map(total, w), nan=jnp.inf)
    return w[jnp.argmin(totals)]


def _score(problem: Problem, inside, w) -> Float[Array, ""]:
    values = psi_at_data(problem, w)
    predicted = problem.target.project(values.reshape(-1, *problem.target.point_shape))
    return held_out_error(problem.target, predicted, problem.y, problem.weights, inside)
