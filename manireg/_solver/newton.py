"""A Newton minimiser in optimistix's form.

optimistix has none, so this composes one. Where to go is a function of its own,
`(exact, y, args, gradient, model) -> Direction`, because Hessians are assembled sparse and
solved by solvers of ours; `exact` is traced, so the program has one copy of it. Far from
the minimum a Gauss-Newton model, always positive definite, gives the direction; near it
the exact Hessian, whose convergence is quadratic (measured on curves: 7..15 steps in
place of 8..60).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import optimistix as optx
from jaxtyping import Array, Bool, Int, PyTree, Scalar, ScalarLike

from .watchdog import Watchdog

COUNTS = "num_newton_steps", "num_trials", "num_steps", "num_rounds"  # among `stats`
KICK = 1e-3  # of the size of y, off a saddle


class Direction(NamedTuple):
    """The full Newton step from a point."""

    step: Any
    convex: Bool[Array, ""]
    """Whether the Hessian was positive definite as it is."""
    model: PyTree
    """The last positive definite model, for those that come after."""


class _Accepted(eqx.Module):
    """What is known at the last accepted point."""

    f: Scalar
    grad: Any
    aux: Any
    step: Any
    stretch: Scalar
    decrease: Scalar
    model: Any
    near: Bool[Array, ""]
    threshold: Scalar
    saddle: Bool[Array, ""]
    done: Bool[Array, ""]


class _NewtonState(eqx.Module):
    y_eval: Any
    search: Watchdog
    num_trials: Int[Array, ""]
    # updated after every accepted trial
    accepted: _Accepted
    num_accepted_steps: Int[Array, ""]
    result: optx.RESULTS
    over: Bool[Array, ""]
    """The search has ended: `y_eval` is where, to be evaluated once more."""
    evaluated: Bool[Array, ""]


class Newton(optx.AbstractMinimiser):
    """Newton's method with a line search (paper, section 4).

    **Arguments:**

    - `rtol`, `atol`: stop when the decrease predicted by the full Newton step,
      half of g^T H^{-1} g, is below `atol + rtol |f|`.
    - `noise`: rounding of the objective f in units of `sqrt |f|`. Where a shorter step
      fails although it promises less than that, rounding is all that is left: success.
    - `direction`: with `exact` False that of the positive definite model. True: that of
      the exact Hessian, tried once the predicted decrease has come below `near |f|`, and
      taken if it points downhill. Where such a step has to be shortened, the minimum is
      flat or not near yet: the model goes on until the decrease is `retry` times smaller.
    - `model`: of the form that `direction` gives and takes, of any numbers: the first
      direction is a model's.
    - `certify`: stop only where the exact Hessian is positive definite. A stationary point
      where it is not is left with a kick of `KICK` times the size of y.
    - `keep_model`: end with the model at the very point that is returned, as
      `stats["model"]`; else it is that of some step before.
    - `slope`: a step has to bring this share of what its slope promises.
    - `patience`: full steps that may fail, in a row (see `Watchdog`).
    - `longest`: the model overestimates the curvature where the residuals curve back. A
      step along the model's direction is stretched by the model's curvature over the
      objective's, seen along the last step, from 1 to at most `longest` (measured on
      curves: a quarter less time, half in the worst cases).
    - `min_step`: give up (`nonlinear_divergence`) when backtracking goes below it.
    - `max_trials`: and after so many points tried (`nonlinear_max_steps_reached`).
    """

    rtol: ScalarLike
    atol: ScalarLike
    direction: Callable[..., Direction]
    model: PyTree = ()
    norm: Callable[[Any], Scalar] = optx.max_norm
    noise: ScalarLike = 0.0
    certify: ScalarLike = False
    keep_model: ScalarLike = False
    near: ScalarLike = 1e-3
    retry: float = 0.1
    slope: float = 1e-4
    patience: int = 3
    longest: float = 4.0
    min_step: float = 1e-8
    max_trials: ScalarLike = 256

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        zero, false = jnp.zeros((), f_struct.dtype), jnp.array(False)
        return _NewtonState(
            y_eval=y,
            search=Watchdog.at(y, f_struct.dtype),
            num_trials=jnp.array(0),
            accepted=_Accepted(
                f=zero,
                grad=jtu.tree_map(jnp.zeros_like, y),
                aux=_zeros(aux_struct),
                step=jtu.tree_map(jnp.zeros_like, y),
                stretch=jnp.ones_like(zero),
                decrease=zero,
                model=self.model,
                near=false,
                threshold=jnp.asarray(self.near, f_struct.dtype),
                saddle=false,
                done=false,
            ),
            num_accepted_steps=jnp.array(0),
            result=optx.RESULTS.successful,
            over=false,
            evaluated=false,
        )

    def step(self, fn, y, args, options, state, tags):
        last, search = state.accepted, state.search
        # at once: what a gradient needs of the value would all pass through a branch
        value_and_grad = jax.value_and_grad(lambda y: fn(y, args), has_aux=True)
        (f_eval, aux_eval), grad = value_and_grad(state.y_eval)
        verdict = search.judge(f_eval, self.patience)

        def accepted():
            exact_tried = last.near & ~search.shortened
            kinds = jnp.where(exact_tried, 2, 1)
            kinds = jnp.where(state.over, 1 * jnp.asarray(self.keep_model), kinds)
            found, decrease, exact, convex = self._downhill(
                kinds, state.y_eval, args, grad, last
            )
            threshold = jnp.where(
                last.near & search.shortened,
                self.retry * decrease / jnp.abs(f_eval),
                last.threshold,
            )
            stretch = jnp.where(exact, 1.0, self._stretch(y, f_eval, state))
            rounding = 8 * jnp.finfo(f_eval.dtype).eps * jnp.abs(f_eval)
            tolerance = self.atol + self.rtol * jnp.abs(f_eval) + rounding
            still = decrease <= tolerance
            near = still | (decrease < threshold * jnp.abs(f_eval))
            minimum = (exact & convex) | ~jnp.asarray(self.certify)
            return state.y_eval, _Accepted(
                f_eval,
                grad,
                aux_eval,
                found.step,
                stretch,
                jnp.where(state.over, last.decrease, decrease),
                found.model,
                near,
                threshold,
                still & exact_tried & ~convex,
                jnp.where(state.over, last.done, still & minimum),
            )

        y, now = jax.lax.cond(verdict.accept, accepted, lambda: (y, last))
        length = search.next_length(verdict)
        promised = 2 * now.decrease * now.stretch * length
        goal = now.f - self.slope * promised
        at_rounding = verdict.shorter & (
            now.decrease <= self.noise * jnp.sqrt(jnp.abs(now.f))
        )
        now = eqx.tree_at(lambda a: a.done, now, now.done | at_rounding)
        kick = verdict.accept & now.saddle & self.certify
        stalled = verdict.shorter & (length < self.min_step)
        tried = state.num_trials + ~state.over
        over = state.over | now.done | stalled | (tried >= self.max_trials)
        next_search = search.after(verdict, y, f_eval, goal)
        forced = verdict.back | kick | over
        next_search = eqx.tree_at(lambda s: s.forced, next_search, forced)

        def next_trial(y, step, reference, lowest):
            step = now.stretch * length * step + jnp.where(kick, _kick(y), 0.0)
            onward = jnp.where(at_rounding, y, y + step)
            onward = jnp.where(over & ~now.done, lowest, onward)
            return jnp.where(verdict.back & ~over, reference, onward)

        trial = jtu.tree_map(next_trial, y, now.step, search.y, next_search.y)
        results = optx.RESULTS
        gave_up = results.where(
            stalled, results.nonlinear_divergence, results.nonlinear_max_steps_reached
        )
        result = results.where(over & ~now.done, gave_up, results.successful)
        new_state = _NewtonState(
            y_eval=trial,
            search=next_search,
            num_trials=tried,
            accepted=now,
            num_accepted_steps=state.num_accepted_steps
            + (verdict.accept & ~state.over),
            result=results.where(state.over, state.result, result),
            over=over,
            evaluated=state.over,
        )
        return y, new_state, now.aux

    def _downhill(self, kinds, y, args, grad, last: _Accepted):
        """Direction, the decrease it promises, whether it is the exact Hessian's, and
        whether that is positive definite. `kinds` 2: the model's direction only if the
        exact one does not point downhill; 1: the model's; 0: none."""

        def attempt(carry):
            kinds, *_, convex = carry
            exact = kinds == 2
            found = self.direction(exact, y, args, grad, last.model)
            decrease = -0.5 * _dot(grad, found.step)
            return kinds - 1, found, decrease, jnp.where(exact, found.convex, convex)

        def unfinished(carry):
            kinds, _, decrease, _ = carry
            return (kinds > 0) & ~(jnp.isfinite(decrease) & (decrease >= 0))

        no = jnp.array(False)
        start = (
            kinds,
            Direction(last.step, no, last.model),
            -jnp.ones_like(last.f),
            no,
        )
        left, found, decrease, convex = jax.lax.while_loop(unfinished, attempt, start)
        return found, decrease, (kinds == 2) & (left == 1), convex

    def _stretch(self, y, f_eval, state):
        """Curvatures along the step just made, s: of the objective, 2 (f' - f - g^T s); of
        the quadratic of decrease d behind it, (g^T s)^2 / 2d."""
        last = state.accepted
        slope = _dot(last.grad, jtu.tree_map(jnp.subtract, state.y_eval, y))
        seen = 2 * (f_eval - last.f - slope)
        expected = slope**2 / (2 * jnp.where(slope == 0, 1.0, last.decrease))
        ratio = expected / jnp.maximum(seen, expected / self.longest)
        alike = (slope != 0) & ~state.search.forced
        return jnp.where(alike, jnp.maximum(ratio, 1.0), 1.0)

    def terminate(self, fn, y, args, options, state, tags):
        results = optx.RESULTS
        result = results.where(state.evaluated, state.result, results.successful)
        return state.evaluated, result

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        last = state.accepted
        stats = {
            "num_newton_steps": state.num_accepted_steps,
            "num_trials": state.num_trials,
            "decrease": last.decrease,
            "objective": last.f,
            "model": last.model,
        }
        return y, aux, stats


def add_counts(stats: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """`stats` of a solve, with the steps of one before it."""
    return {**stats, **{name: stats[name] + before[name] for name in COUNTS}}


def _dot(a, b):
    products = jtu.tree_map(lambda a, b: jnp.sum(a * b), a, b)
    return jtu.tree_reduce(jnp.add, products)


def _kick(y):
    """A small random displacement, always the same."""
    size = KICK * jnp.sqrt(jnp.mean(y**2))
    return size * jax.random.normal(jax.random.key(0), y.shape, y.dtype)


def _zeros(struct):
    is_struct = lambda x: isinstance(x, jax.ShapeDtypeStruct)
    fill = lambda x: jnp.zeros(x.shape, x.dtype) if is_struct(x) else x
    return jtu.tree_map(fill, struct, is_leaf=is_struct)
