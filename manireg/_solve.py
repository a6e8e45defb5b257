"""From a problem and a lambda to a fitted map: starts, Newton, implicit derivatives."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike, Float, ScalarLike

from ._checks import check_lam, check_points, is_concrete, projected
from ._hessian import exact, gauss_newton
from ._jets import centres_near
from ._linear_solvers import DirectSolvers, direct_solvers
from ._local_polynomials import LocalPolynomials, basis_values, cover
from ._minimise import Method, minimise, newton_minimiser, stage_of
from ._objective import Energies, Stage, objective
from ._problem import Problem
from ._resolution import warn_where_coarse
from ._sources import Source
from .manifolds import AbstractManifold, Euclidean

STARTS = (1.0, 1e-2)


class RegressionMap(eqx.Module):
    """A fitted map from `source` to `target`: call it on new points."""

    source: Source
    target: AbstractManifold
    basis: LocalPolynomials
    coefficients: Float[Array, "KC t"]
    lam: Float[Array, ""]
    energies: Energies
    result: optx.RESULTS
    stats: dict[str, Any]

    def __call__(self, x: ArrayLike) -> Float[Array, "..."]:
        """Values at `x`, `(n, *source.point_shape)`: `(n, *target.point_shape)`, on the
        target.

        **Raises** ValueError (for traced `x`: a run-time error) outside the source or its
        cover.
        """
        if is_concrete(x):
            flat = jnp.asarray(check_points("x", self.source, x))
        else:
            points = jnp.asarray(x)
            flat = points.reshape(len(points), -1)
        values, covered = evaluate(self.basis, self.coefficients, flat)
        values = eqx.error_if(
            values,
            ~covered,
            "x: some points lie outside the support of every centre of the fitted map; "
            "fit with inputs that cover them.",
        )
        return projected(self.target, values.reshape(-1, *self.target.point_shape))


def evaluate(
    basis: LocalPolynomials, w: Float[Array, "KC t"], x: Float[Array, "n s"]
) -> tuple[Float[Array, "n t"], Array]:
    """Psi at `x`, before the projection to N; and whether all of `x` is covered. Traced
    points are compared with all centres, others only with those near them."""
    concrete = is_concrete(x, basis.centres, basis.widths)
    near = jnp.asarray(centres_near(basis, np.asarray(x))) if concrete else None
    return _evaluate(basis, w, x, near)


@eqx.filter_jit
def _evaluate(basis, w, x, near):
    everywhere = jnp.arange(len(basis.centres))
    w = w.reshape(len(basis.centres), basis.size, -1)

    def one(x, near=everywhere):
        values = basis_values(basis, x, near).reshape(len(near), -1)
        psi = jnp.einsum("lc,lct->t", values, w[near])
        return psi, cover(basis, x, near) > 1e-6

    points = (x,) if near is None else (x, near)
    values, covered = jax.lax.map(lambda point: one(*point), points, batch_size=256)
    return values, jnp.all(covered)


def solve(
    problem: Problem,
    lam: ScalarLike,
    *,
    method: Method = "projected",
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
    - `lam`: lambda > 0, exactly as in the formula; it has the unit of length^{4-m} of the
      source.
    - `method`: `"projected"` (default) minimises the Eells energy of $\pi \circ \Psi$,
      with a weak pull of Psi towards N that fixes the gauge; the result lies on N and no
      continuation is needed. `"penalty"` is the paper's: energy with the projector at
      $\Psi$, plus $\gamma \int |\Psi - \pi\Psi|^2$ with gamma raised in stages.
      Measured on curves on the sphere: same minimisers, a third of the Newton steps.
    - `starts`: the free (thin plate) solutions at `lam * factor`, one a factor; the
      lowest objective found is returned.
    - `warm`: coefficients of a map fitted on the same problem, as one more start.
    - `rtol`: relative decrease of the objective below which Newton stops.
    - `max_steps`: trial steps allowed.
    - `linear_algebra`: `"sparse"` (CPU), `"dense"` (any device), `"auto"`.
    - `throw`: raise if Newton fails; else look at `.result`.

    **Warns** (`ResolutionWarning`) where the basis is coarser than data and lambda ask
    for: more `centres` resolve more.
    """
    check_lam(lam)
    if method not in ("projected", "penalty"):
        raise ValueError(
            f"method: expected 'projected' or 'penalty', found {method!r}."
        )
    warn_where_coarse(problem, lam)
    solvers = direct_solvers(linear_algebra, problem.basis.dim)
    model = _solve(
        problem,
        jnp.asarray(lam, float),
        tuple(starts),
        warm,
        method,
        solvers,
        rtol,
        max_steps,
    )
    if not throw:
        return model
    failed = model.result != optx.RESULTS.successful
    w = model.result.error_if(model.coefficients, failed)
    return eqx.tree_at(lambda m: m.coefficients, model, w)


@eqx.filter_jit
def _solve(problem, lam, starts, warm, method, solvers, rtol, max_steps):
    fixed = jax.lax.stop_gradient(eqx.filter(problem, eqx.is_array))
    fixed = eqx.combine(fixed, problem)
    frozen_lam = jax.lax.stop_gradient(lam)
    newton = newton_minimiser(solvers, rtol)
    arrays, rest = eqx.partition((fixed, frozen_lam, warm), eqx.is_array)

    # In lockstep all lanes of a vmap would wait for the slowest, and take both branches of
    # every choice: measured, 2.3 times the time of a loop.
    @jax.custom_batching.sequential_vmap
    def lowest(arrays):
        problem, lam, warm = eqx.combine(arrays, rest)
        free = lambda factor: free_solution(problem, factor * lam, solvers)
        w0 = [jax.lax.map(free, jnp.array(starts))] if starts else []
        candidates = jax.lax.map(
            lambda w0: minimise(problem, lam, w0, method, newton, max_steps),
            jnp.concatenate(w0 + ([] if warm is None else [warm[None]])),
        )
        best = jnp.argmin(jnp.nan_to_num(candidates[2], nan=jnp.inf))
        return jax.tree.map(lambda a: a[best], candidates)

    w, gamma, _, result, stats = lowest(arrays)
    stage = stage_of(problem, lam, gamma, method, jax.lax.stop_gradient(w))
    w = _implicit(stage, w, solvers)
    _, energies = objective(w, stage)
    return RegressionMap(
        problem.source, problem.target, problem.basis, w, lam, energies, result, stats
    )


def free_solution(
    problem: Problem, lam: ScalarLike, solvers: DirectSolvers
) -> Float[Array, "KC t"]:
    """The minimiser with N = R^t: a thin-plate spline, one linear solve."""
    free = free_problem(problem)
    w = jnp.zeros((problem.pattern.size, problem.y.shape[1]))
    stage = Stage(free, lam, 0.0, False)
    gradient = jax.grad(lambda w: objective(w, stage)[0])(w)
    # every coordinate has the same matrix
    one = eqx.tree_at(lambda s: s.problem, stage, _first_coordinate(free))
    factor = solvers.positive.init(gauss_newton(w[:, :1], one), {})
    return -solvers.positive.compute(factor, gradient[:, None], {})[0][:, 0]


def _first_coordinate(problem: Problem) -> Problem:
    where = lambda p: (p.target, p.y)
    one = eqx.tree_at(where, problem, (Euclidean(1), problem.y[:, :1]))
    if problem.tension is None:
        return one
    derivative = problem.tension.derivative[:, :1]
    return eqx.tree_at(lambda p: p.tension.derivative, one, derivative)


def free_problem(problem: Problem) -> Problem:
    """The same data, ambient space as the target."""
    where = lambda p: (p.target, p.energy_jets)
    ambient = Euclidean(problem.y.shape[1])
    return eqx.tree_at(where, problem, (ambient, problem.free_jets))


@eqx.filter_custom_jvp
def _implicit(stage: Stage, w: Float[Array, "KC t"], solvers: DirectSolvers):
    """`w`, with the derivative of a minimiser: dw = -H^{-1} d(grad E)."""
    return w


@_implicit.def_jvp
def _(primals, tangents):
    stage, w, solvers = primals
    gradient = lambda stage: jax.grad(lambda w: objective(w, stage)[0])(w)
    _, moved = eqx.filter_jvp(gradient, (stage,), (tangents[0],))
    hessian = exact(w, stage, gauss_newton(w, stage))
    # no `throw`: it would be a callback, and those neither run on every device nor cache
    return w, -lx.linear_solve(hessian, moved, solvers.indefinite, throw=False).value
