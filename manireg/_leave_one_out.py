"""Choice of lambda from one fit per lambda: what each datum would miss if left out, from
the Hessian at the minimum (mathematics: 10.1)."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float
from tqdm.auto import tqdm

from ._checks import check_lam
from ._densities import project_flat
from ._hessian import gauss_newton
from ._jets import in_order, jet_values
from ._linear_solvers import DirectSolvers, direct_solvers
from ._minimise import minimise, newton_minimiser, stage_of
from ._objective import at_data
from ._problem import Problem
from ._selection import CrossValidation, lambda_grid
from ._solve import free_solution, solve

VALUES = 8  # of a default grid
RTOL = 1e-4  # relative decrease at which the fits of the path stop


def leave_one_out(
    problem: Problem,
    lams: Sequence[float] | Float[Array, " lams"] | None = None,
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
    for each fold, too. The lambdas are followed downwards, each from its neighbour.

    **Arguments:** `problem` from `make_problem`; `lams` the grid, default eight values of
    `lambda_grid`; `progress` show a progress bar. **Returns** what `cross_validate` does,
    with one fold a datum: `scores` are the predicted lengths of the residuals.
    """
    if lams is None:
        grid = lambda_grid(problem, VALUES)
    else:
        check_lam(lams, "lams")
        grid = jnp.sort(jnp.asarray(lams, float).ravel())
    solvers = direct_solvers(linear_algebra)
    w = eqx.filter_jit(free_solution)(problem, grid[-1], solvers)
    fits = []
    for lam in tqdm(grid[::-1], "leave-one-out", disable=not progress, leave=False):
        w, *scored = _fit_and_score(problem, lam, w, solvers, max_steps)
        fits.append((jax.block_until_ready(w), *scored))
    paths, scores, converged = (jnp.stack(a[::-1]) for a in zip(*fits, strict=True))
    best = jnp.argmin(jnp.mean(scores, axis=1))
    model = solve(
        problem,
        grid[best],
        starts=(),
        warm=paths[best],
        rtol=RTOL,
        linear_algebra=linear_algebra,
        throw=False,
    )
    converged = jnp.broadcast_to(converged, scores.T.shape)
    return CrossValidation(grid[best], grid, scores.T, converged, model)


@eqx.filter_jit
def _fit_and_score(problem: Problem, lam, w, solvers: DirectSolvers, max_steps: int):
    newton = newton_minimiser(solvers, RTOL)
    w, gamma, _, result, _ = minimise(problem, lam, w, "projected", newton, max_steps)
    errors = left_out_errors(problem, lam, gamma, w, solvers)
    return w, errors, result == optx.RESULTS.successful


def left_out_errors(
    problem: Problem, lam, gamma, w: Float[Array, "KC t"], solvers: DirectSolvers
) -> Float[Array, " k"]:
    """Length of each datum's residual in the fit without it, to first order."""
    stage = stage_of(problem, lam, gamma, "projected", w)
    jets, k, t = problem.data_jets, len(problem.y), problem.y.shape[1]
    values = jet_values(jets, w)[:, :, 0]
    slope = lambda target, psi: jax.jacfwd(lambda psi: project_flat(target, psi))(psi)
    residual = at_data(stage, project_flat, values) - problem.y[jets.index]
    projection = at_data(stage, slope, values)

    # J_i^T as columns: basis values (U) times D pi (t x t), one per datum and component
    columns = jnp.einsum("epu,eprt->eputr", jets.matrices[:, :, 0], projection)
    columns = columns * jets.mask[:, :, None, None, None]
    places = jnp.broadcast_to(jets.columns[:, None], columns.shape[:3])
    owner = jnp.broadcast_to(jets.index[:, :, None], columns.shape[:3])
    rhs = jnp.zeros((len(w), t, k, t))
    rhs = rhs.at[places, :, owner].add(columns)
    solver = solvers.positive
    state = solver.init(gauss_newton(w, stage), {})
    solution, _, _ = solver.compute(state, rhs.reshape(len(w), t, k * t), {})
    solution = solution.reshape(len(w), t, k, t)
    leverage = jnp.einsum("wtkr,wtkq->krq", rhs, solution)
    share = problem.weights / jnp.sum(problem.weights)
    residuals = in_order(jets, residual, k)
    left = jnp.eye(t) - 2 * share[:, None, None] * leverage
    return jnp.linalg.norm(jnp.linalg.solve(left, residuals[..., None])[..., 0], axis=1)
