"""From a problem and a lambda to a fitted map: starts, Newton, implicit derivatives."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from .._input.numbers import Numbers
from .._input.precision import as_scalar, check_x64
from .._objective.arguments import argument
from .._objective.hessian import exact, gauss_newton
from .._objective.noise import check_scale
from .._objective.objective import objective
from .._objective.problem import Problem
from .._objective.resolution import warn_where_coarse
from .._objective.sites import Stage
from .._objective.wavelengths import given_lambda
from .._programs.program import program
from .._sources.checks import is_concrete
from .fitted import Limits, fitted
from .linear import AbstractSolvers, direct_solvers
from .minima import compared, lowest
from .minimise import Method, minimise, newton_minimiser, stage_of
from .minimum import Minimum, is_successful, unsolved
from .model import RegressionMap, regression_map
from .newton import add_counts
from .starts import starts_of, stride

STARTS = (1.0, 1e-2)
ON_THE_WAY = 1e-3  # relative decrease at which Newton stops there
CURE = (
    "Try another `lam`, more `starts` such as (1.0, 0.01, 0.0001), or `warm`, the "
    "coefficients of a fit with a `lam` next to it; `throw=False` gives the map as it is."
)


def solve(
    problem: Problem,
    lam: Numbers | None = None,
    *,
    wavelength: Numbers | None = None,
    method: Method | None = None,
    starts: Sequence[float] = STARTS,
    warm: Float[Array, "KC t"] | None = None,
    rtol: float = 1e-12,
    max_steps: int = 256,
    linear_algebra: str = "auto",
    throw: bool = True,
) -> RegressionMap:
    r"""Minimise (1/k) sum d^2(y_i, Psi(x_i)) + lam S(Psi) for a given lambda.

    Works under `jit`, `vmap` over `lam` (or over leaves of `problem`) and `grad` with
    respect to `lam`, `problem.y` and `problem.weights` (implicit differentiation with the
    exact Hessian).

    **Arguments:**

    - `problem`: from `make_problem`.
    - `lam`: lambda > 0, one number, exactly as in the formula; it has the unit of
      length^{2p-m} of the source, p the order of the energy.
    - `wavelength`: in its place, a length in the unit of x:
      $\lambda = (\ell / 2\pi)^{2p} / V$, V the volume that the data fill (of data evenly
      spread over an interval its length). Waves of that length are damped by a half,
      $1 / (1 + (\ell / L)^{2p})$ of those of length L is left.
    - `method`: `"projected"` (the default, but on `Ambient` sources) minimises the Eells
      energy of $\pi \circ \Psi$, with a weak pull of Psi towards N that fixes the gauge;
      the result lies on N and no continuation is needed. `"penalty"` is the paper's:
      energy with the projector at $\Psi$, plus $\gamma \int |\Psi - \pi\Psi|^2$ with gamma
      raised in stages. Measured on curves on the sphere: same minimisers, a third of the
      Newton steps. On `Ambient` sources Psi is a map of the whole neighbourhood, which
      need not stay on N off the manifold, so `"projected"` is an error there, and the
      default is the energy of `"penalty"` with one gamma, 10 / vol(M).
    - `starts`: one a factor, the free (thin plate) solution at `lam * factor`, projected
      onto N, or where its objective is lower and the factor at least 1 the spline of
      logarithms; below 1 at no more than the lambda whose wavelength is 1.5 spacings of
      the data, and followed up to `lam` from there. The lowest minimum is returned.
    - `warm`: coefficients of a map fitted on the same problem, as one more start.
    - `rtol`: relative decrease of the objective below which Newton stops; on a
      `PointCloud` not less than 1e-3, as its patches are wrong by more, and for orders 3
      and 4 not less than 1e-10, where rounding begins.
    - `max_steps`: trial steps allowed, at least 1. On a `PointCloud` those of all rounds,
      each on the patches of the one before; at most 12 rounds of 4. There a fit is
      `successful` if it met `rtol` and less than 1 % of the patches changed at the end.
    - `linear_algebra`: `"sparse"` (CPU), `"dense"` (any device), `"auto"`: dense on a GPU
      and off curves for up to 4,500 unknowns that meet many others.
    - `throw`: raise if Newton fails; else look at `.result`.

    **Raises** ValueError for float32 mode and arguments that are not as above.
    **Warns** (`ResolutionWarning`) where the basis is coarser than data and lambda ask
    for and residuals of neighbouring data are alike: more `centres` resolve more; and
    (`SeveralMinimaWarning`) where a start ends in a minimum less than 1 % higher, in a
    map that differs by more than the data do. `stats` tells the number of minima and the
    relative gap to the second (not of traced problems).

    **Example:** the path at 65 Ma, and how it depends on lambda.

    ```python
    data = mr.datasets.polar_wander("india")  # 33 poles: ages, unit vectors
    interval, sphere = mr.Interval(0, 320), mr.Sphere(2)
    problem = mr.make_problem(interval, sphere, data.ages, data.directions)
    place = lambda lam: mr.solve(problem, lam)(65.0)
    place(1e3), jax.jacfwd(place)(1e3)
    ```
    """
    lam = given_lambda(problem, lam, wavelength)
    _check_options(problem, method, starts, warm, max_steps)
    solvers = direct_solvers(problem, linear_algebra)
    options = method or "projected", solvers, rtol, max_steps
    known = is_concrete(*jax.tree.leaves((problem, lam, warm)))
    find = _one_by_one if known else _in_one_program
    found = find(argument(problem), lam, tuple(map(float, starts)), warm, *options)
    model = regression_map(problem, *found)
    warn_where_coarse(problem, model.coefficients, model.lam)
    return checked(model, max_steps) if throw else model


def checked(model: RegressionMap, max_steps: int) -> RegressionMap:
    """The model, if Newton converged.

    **Raises** RuntimeError that says how far it came and what may help; of a traced model
    a run-time error."""
    if not is_concrete(*jax.tree.leaves(model.result)):
        failed = model.result != optx.RESULTS.successful
        message = f"fit: Newton did not converge within max_steps = {max_steps}. {CURE}"
        w = eqx.error_if(model.coefficients, failed, message)
        return eqx.tree_at(lambda m: m.coefficients, model, w)
    if not is_successful(model.result):
        steps, energies = int(model.stats["num_steps"]), model.energies
        total = float(energies.loss + model.lam * energies.energy)
        raise RuntimeError(
            f"fit: Newton did not converge for lam = {float(model.lam):.4g}. The lowest "
            f"map of all starts has the objective {total:.6g} (root mean square residual "
            f"{float(energies.loss) ** 0.5:.3g}) after {steps} steps (max_steps = "
            f"{max_steps}); the next one promised {float(model.stats['decrease']):.2g} "
            f"less. {CURE}"
        )
    return model


def _check_options(problem: Problem, method, starts, warm, max_steps: int):
    if method not in (None, "projected", "penalty"):
        raise ValueError(
            f"method: expected 'projected' or 'penalty', found {method!r}."
        )
    check_x64(problem)
    check_scale(problem.misfit)
    if method == "penalty" and not problem.target.isometric:
        raise ValueError(
            f"method: 'penalty' measures in the ambient space, whose metric "
            f"{type(problem.target).__name__} does not have; leave it out."
        )
    if method == "penalty" and problem.energy.order != 2:
        raise ValueError(
            "method: 'penalty' is the paper's, for order 2; leave it out for order "
            f"{problem.energy.order}."
        )
    if method == "projected" and not problem.energy.on_target:
        raise ValueError(
            "method: 'projected' is not defined on Ambient sources; leave it out, for the "
            "energy of the map of the neighbourhood, or take 'penalty'."
        )
    if len(starts) == 0 and warm is None:
        raise ValueError(
            "starts: there is nothing to start from; give at least one factor, such as "
            "1.0, or coefficients `warm`."
        )
    expected = (problem.pattern.size, problem.y.shape[1])
    if warm is not None and jnp.shape(warm) != expected:
        raise ValueError(
            f"warm: expected coefficients {expected} of a map fitted on the same problem, "
            f"found shape {jnp.shape(warm)}."
        )
    if max_steps < 1:
        raise ValueError(f"max_steps: must be at least 1, found {max_steps}.")


def _one_by_one(problem, lam, starts, warm, method, solvers, rtol, max_steps):
    """By programs that all fits share. The minimum is the lowest of all starts, each
    followed from its first lambda to `lam` in steps of at most a factor of `stride`."""
    goal, step = float(lam), stride(problem)

    def follow(w, now) -> Minimum:
        last = bool(now >= goal)
        limits = Limits(rtol if last else max(rtol, ON_THE_WAY), max_steps, last)
        found, _ = fitted(problem, as_scalar(now), w, limits, solvers, method=method)
        found = found._replace(stats=jax.tree.map(np.asarray, found.stats))
        if last:
            return found
        onward = step * now if step * now < (1 - 1e-9) * goal else goal
        further = follow(found.w, onward)
        return further._replace(stats=add_counts(further.stats, found.stats))

    lanes = []
    if starts:
        lanes += zip(*map(np.asarray, _starts(problem, lam, starts, method, solvers)))
    if warm is not None:
        lanes.append((warm, goal))
    found = [follow(*lane) for lane in lanes]
    height = lambda minimum: float(minimum.objective)
    best = lowest(found, height, lambda minimum: is_successful(minimum.result))
    stats = jax.device_put({**best.stats, **compared(problem, found)})
    return best.w, lam, best.energies, best.result, stats


_starts = program(most=8)(starts_of)


@eqx.filter_jit
def _in_one_program(problem, lam, starts, warm, method, solvers, rtol, max_steps):
    fixed = jax.lax.stop_gradient(eqx.filter(problem, eqx.is_array))
    fixed = eqx.combine(fixed, problem)
    frozen_lam = jax.lax.stop_gradient(lam)
    arrays, rest = eqx.partition((fixed, frozen_lam, warm), eqx.is_array)

    # In lockstep all lanes of a vmap would wait for the slowest, and take both branches of
    # every choice: measured, 2.3 times the time of a loop.
    @jax.custom_batching.sequential_vmap
    def lowest(arrays):
        problem, lam, warm = eqx.combine(arrays, rest)
        lanes = [starts_of(problem, lam, starts, method, solvers)] if starts else []
        lanes += [] if warm is None else [(warm[None], lam[None])]
        options = method, solvers, rtol, max_steps
        follow = lambda lane: _followed(problem, lam, lane, *options)
        lanes = jax.tree.map(lambda *parts: jnp.concatenate(parts), *lanes)
        candidates = jax.lax.map(follow, lanes)
        best = jnp.argmin(jnp.nan_to_num(candidates.objective, nan=jnp.inf))
        return jax.tree.map(lambda a: a[best], candidates)

    found = lowest(arrays)
    stage = stage_of(problem, lam, found.gamma, method, jax.lax.stop_gradient(found.w))
    w = _implicit(stage, found.w, solvers)
    _, energies = objective(w, stage)
    return w, lam, energies, found.result, found.stats


def _followed(problem, lam, lane, method, solvers, rtol, max_steps):
    """From a start to the minimum at its first lambda, and on to the one at `lam` in a few
    steps of at most a factor of `stride`. `lane`: coefficients, first lambda."""
    (w, first), step = lane, stride(problem)

    def solve_at(now, w):
        last = now >= lam
        tolerance = jnp.where(last, rtol, jnp.maximum(rtol, ON_THE_WAY))
        newton = newton_minimiser(solvers, tolerance, max_steps, certify=last)
        return minimise(problem, now, w, method, newton)

    def on_the_way(carry):
        return carry[0] < lam

    def go_on(carry):
        now, before = carry
        now = jnp.where(step * now < (1 - 1e-9) * lam, step * now, lam)
        found = solve_at(now, before.w)
        return now, found._replace(stats=add_counts(found.stats, before.stats))

    # the first lambda is that of a step taken from nowhere: one program serves all
    start = first / step, unsolved(stage_of(problem, lam, 0.0, method, w), w)
    return jax.lax.while_loop(on_the_way, go_on, start)[1]


@eqx.filter_custom_jvp
def _implicit(stage: Stage, w: Float[Array, "KC t"], solvers: AbstractSolvers):
    """`w`, with the derivative of a minimiser: dw = -H^{-1} d(grad E)."""
    return w


@_implicit.def_jvp
def _(primals, tangents):
    stage, w, solvers = primals
    gradient = lambda stage: jax.grad(lambda w: objective(w, stage)[0])(w)
    _, moved = eqx.filter_jvp(gradient, (stage,), (tangents[0],))
    hessian = exact(w, stage, gauss_newton(w, stage))
    # no `throw`: it would be a callback, and those neither run on every device nor cache
    return w, -lx.linear_solve(hessian, moved, solvers.at_minimum, throw=False).value
