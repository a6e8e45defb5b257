"""Choice of lambda from one fit per lambda: what each datum would miss if left out, from
the Hessian at the minimum (mathematics: 10.1)."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float
from tqdm.auto import tqdm

from .._input.numbers import Numbers
from .._input.precision import check_x64
from .._objective.objective import objective
from .._objective.problem import Problem
from .._objective.resolution import warn_where_coarse
from .._objective.wavelengths import lambda_of_wavelength, mean_spacing
from .._solver.leverages import left_out_errors
from .._solver.linear import DirectSolvers, direct_solvers
from .._solver.minimise import minimise, newton_minimiser, stage_of
from .._solver.solve import RegressionMap, regression_map
from .._solver.starts import free_solution
from .._sources.checks import check_lams
from .cross_validate import CrossValidation

LONGEST = 2.7  # wavelength at the top of the default grid, in spacings of the data
VALUES, RATIO = 5, 3.4  # of it: down to wavelengths of 0.8 spacings
EXTENSIONS = 2  # at most, where the best value sits on an edge
RTOL = 1e-4  # relative decrease at which the fits of the path stop


def leave_one_out(
    problem: Problem,
    lams: Numbers | None = None,
    *,
    linear_algebra: str = "auto",
    max_steps: int = 40,
    progress: bool = True,
) -> CrossValidation:
    r"""Choose lambda by approximate leave-one-out cross-validation: with
    $r_i = \pi\Psi(x_i) - y_i$, its derivative $J_i$ in the coefficients and the
    (Gauss-Newton) Hessian H, the residual of the fit without datum i is
    $(I - h_i)^{-1} r_i$, $h_i = 2 s_i J_i H^{-1} J_i^\top$, $s_i$ the share of its
    weight. Exact for linear problems; one fit a lambda, where `cross_validate` takes one
    for each fold, too. The lambdas are followed downwards, each from its neighbour:
    started from the free solution of a small lambda, maps fold up far from the data.

    Few data predict errors roughly, and beside them a far too small lambda costs more than
    one too large: chosen is the largest lambda whose score lies within one standard error
    of the lowest (Breiman, Friedman, Olshen and Stone 1984, section 3.4.3). Scores are
    means with the largest tenth cut to the ninth decile: where the map may fold without a
    datum, to first order it flies off, and that datum alone would decide.

    **Arguments:** `problem` from `make_problem`; `lams` the grid, default five values of
    wavelengths (see `lambda_grid`) from 2.7 to 0.8 spacings of the data, extended (at most
    twice) where the best value or the choice sits on an edge; `progress` show a bar.
    **Returns** what `cross_validate` does, with one fold a datum (of positive weight):
    `scores` are the predicted lengths of the residuals, times the data's relative weights.
    """
    check_x64(problem)
    given = lams is not None
    heavy = np.asarray(problem.weights) > 0
    if given:
        grid = check_lams(lams)[::-1]
    else:
        grid = np.asarray(_grid(problem))[::-1]
    solvers = direct_solvers(linear_algebra, problem.basis.dim)
    w = eqx.filter_jit(free_solution)(problem, jnp.asarray(grid[0]), solvers)
    fits: dict[float, tuple[RegressionMap, np.ndarray]] = {}

    def visit(lam: float, w):
        # a Python number would be compiled into the program
        traced = jnp.asarray(lam)
        model, errors = _fit_and_score(problem, traced, w, solvers, max_steps)
        fits[lam] = model, np.nan_to_num(np.asarray(errors)[heavy], nan=np.inf)
        bar.update()
        # a fit that ends in no numbers is no start for the next
        return model.coefficients if np.all(np.isfinite(model.coefficients)) else w

    with tqdm(total=len(grid), desc="leave-one-out", disable=not progress) as bar:
        for lam in grid:
            w = visit(float(lam), w)
        for _ in range(0 if given else EXTENSIONS):
            best, chosen = _best(fits), _choice(fits)
            if best == min(fits):
                visit(best / RATIO, fits[best][0].coefficients)
            elif chosen == max(fits):
                visit(chosen * RATIO, fits[chosen][0].coefficients)
            else:
                break
    visited = sorted(fits)
    scores = np.stack([fits[lam][1] for lam in visited], axis=1)
    successful = [
        bool(fits[lam][0].result == optx.RESULTS.successful) for lam in visited
    ]
    chosen = _choice(fits)
    warn_where_coarse(problem, chosen)
    return CrossValidation(
        jnp.asarray(chosen),
        jnp.asarray(visited),
        jnp.asarray(scores),
        jnp.broadcast_to(jnp.asarray(successful), scores.shape),
        fits[chosen][0],
    )


def _best(fits: dict[float, tuple[RegressionMap, np.ndarray]]) -> float:
    """The lambda of the lowest score."""
    best = min(fits, key=lambda lam: cut_errors(fits[lam][1]).mean())
    if not np.all(np.isfinite(fits[best][1])):
        raise ValueError(
            "lams: no fit ended in numbers, so there is no lambda to choose; check the "
            "scale of the data and of `lams`."
        )
    return best


def _choice(fits: dict[float, tuple[RegressionMap, np.ndarray]]) -> float:
    """The largest lambda within one standard error of the best."""
    cut = {lam: cut_errors(errors) for lam, (_, errors) in fits.items()}
    best = cut[_best(fits)]
    allowed = best.mean() + best.std(ddof=1) / np.sqrt(len(best))
    return max(lam for lam, errors in cut.items() if errors.mean() <= allowed)


def cut_errors(errors: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """The largest tenth cut to the ninth decile; all infinite where one is."""
    if not np.all(np.isfinite(errors)):
        return np.full_like(errors, np.inf)
    return np.minimum(errors, np.quantile(errors, 0.9))


def _grid(problem: Problem) -> Float[Array, " lams"]:
    longest = lambda_of_wavelength(problem, LONGEST * mean_spacing(problem))
    return longest * RATIO ** -jnp.arange(VALUES)[::-1]


@eqx.filter_jit
def _fit_and_score(problem: Problem, lam, w, solvers: DirectSolvers, max_steps: int):
    newton = newton_minimiser(solvers, RTOL)
    found = minimise(problem, lam, w, "projected", newton, max_steps)
    stage = stage_of(problem, lam, found.gamma, "projected", found.w)
    _, energies = objective(found.w, stage)
    model = regression_map(problem, found.w, lam, energies, found.result, found.stats)
    errors = left_out_errors(found.w, stage, solvers)
    mean = jnp.sum(problem.weights) / jnp.sum(problem.weights > 0)
    return model, errors * problem.weights / mean
