"""A Newton minimiser in optimistix's form.

optimistix has none, so this composes one: the loop below, `optx.NewtonDescent` for the
direction. Hessians are functions of their own, `(y, args) -> lineax operator`, because
they are assembled sparse; the exact one is also given the last model, `(y, args, model)`.
Far from the minimum a Gauss-Newton model, always positive definite, gives the direction;
near it the exact Hessian, whose convergence is quadratic (measured on curves: 7..15 steps
in place of 8..60).
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import optimistix as optx
from jaxtyping import Array, Bool, Int, Scalar, ScalarLike

from .watchdog import Watchdog

KICK = 1e-3  # of the size of y, off a saddle


class _Accepted(eqx.Module):
    """What is known at the last accepted point."""

    f_info: Any
    aux: Any
    descent_state: Any
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


class Newton(optx.AbstractMinimiser):
    """Newton's method with a line search (paper, section 4).

    **Arguments:**

    - `rtol`, `atol`: stop when the decrease predicted by the full Newton step,
      half of g^T H^{-1} g, is below `atol + rtol |f|`.
    - `noise`: rounding of the objective f in units of `sqrt |f|`. Where a shorter step
      fails although it promises less than that, rounding is all that is left: success.
    - `model_hessian`, `model_descent`: the positive definite model, and the descent that
      holds its linear solver.
    - `exact_hessian`, `exact_descent`: the same for the exact Hessian, tried once the
      predicted decrease has come below `near |f|`, and taken if it points downhill. Where
      such a step has to be shortened, the minimum is flat or not near yet: the model goes
      on until the decrease is `retry` times smaller. Its solver says `singular` where the
      Hessian is not positive definite.
    - `certify`: stop only where the exact Hessian is positive definite. A stationary point
      where it is not is left with a kick of `KICK` times the size of y.
    - `slope`: a step has to bring this share of what its slope promises.
    - `patience`: full steps that may fail, in a row (see `Watchdog`).
    - `longest`: the model overestimates the curvature where the residuals curve back. A
      step along the model's direction is stretched by the model's curvature over the
      objective's, seen along the last step, from 1 to at most `longest` (measured on
      curves: a quarter less time, half in the worst cases).
    - `min_step`: give up (`nonlinear_divergence`) when backtracking goes below it.
    """

    rtol: ScalarLike
    atol: ScalarLike
    model_hessian: Callable
    exact_hessian: Callable
    model_descent: optx.AbstractDescent
    exact_descent: optx.AbstractDescent
    norm: Callable[[Any], Scalar] = optx.max_norm
    noise: ScalarLike = 0.0
    certify: ScalarLike = False
    near: float = 1e-3
    retry: float = 0.1
    slope: float = 1e-4
    patience: int = 3
    longest: float = 4.0
    min_step: float = 1e-8

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        grad = jax.eval_shape(lambda: y)
        f_info = optx.FunctionInfo.EvalGrad(f_struct, grad)
        hessian = eqx.filter_eval_shape(self.model_hessian, y, args)
        with_hessian = optx.FunctionInfo.EvalGradHessian(f_struct, grad, hessian)
        zero, false = jnp.zeros((), f_struct.dtype), jnp.array(False)
        return _NewtonState(
            y_eval=y,
            search=Watchdog.at(y, f_struct.dtype),
            num_trials=jnp.array(0),
            accepted=_Accepted(
                f_info=_zeros(f_info),
                aux=_zeros(aux_struct),
                descent_state=self.model_descent.init(y, with_hessian),
                stretch=jnp.ones_like(zero),
                decrease=zero,
                model=_zeros(hessian),
                near=false,
                threshold=jnp.asarray(self.near, f_struct.dtype),
                saddle=false,
                done=false,
            ),
            num_accepted_steps=jnp.array(0),
            result=optx.RESULTS.successful,
        )

    def step(self, fn, y, args, options, state, tags):
        last, search = state.accepted, state.search
        f_eval, vjp, aux_eval = jax.vjp(
            lambda y: fn(y, args), state.y_eval, has_aux=True
        )
        verdict = search.judge(f_eval, self.patience)

        def accepted():
            (grad,) = vjp(jnp.ones_like(f_eval))
            f_info = optx.FunctionInfo.EvalGrad(f_eval, grad)

            def query(descent, hessian):
                info = optx.FunctionInfo.EvalGradHessian(f_eval, grad, hessian)
                new_state = descent.query(state.y_eval, info, last.descent_state)
                step, result = descent.step(jnp.ones_like(f_eval), new_state)
                decrease = -0.5 * f_info.compute_grad_dot(step)
                return new_state, decrease, result == optx.RESULTS.successful

            def query_exact():
                hessian = self.exact_hessian(state.y_eval, args, last.model)
                return *query(self.exact_descent, hessian), last.model

            def query_model():
                hessian = self.model_hessian(state.y_eval, args)
                return *query(self.model_descent, hessian), hessian

            def nothing():
                no = jnp.full_like(f_eval, -1.0)
                return last.descent_state, no, jnp.array(False), last.model

            exact_tried = last.near & ~search.shortened
            exact = jax.lax.cond(exact_tried, query_exact, nothing)
            _, decrease, convex, _ = exact
            downhill = jnp.isfinite(decrease) & (decrease > 0)
            descent_state, decrease, _, model = jax.lax.cond(
                downhill, lambda: exact, query_model
            )
            threshold = jnp.where(
                last.near & search.shortened,
                self.retry * decrease / jnp.abs(f_eval),
                last.threshold,
            )
            stretch = jnp.where(downhill, 1.0, self._stretch(y, f_eval, state))
            rounding = 8 * jnp.finfo(f_eval.dtype).eps * jnp.abs(f_eval)
            tolerance = self.atol + self.rtol * jnp.abs(f_eval) + rounding
            still = decrease <= tolerance
            near = still | (decrease < threshold * jnp.abs(f_eval))
            minimum = (downhill & convex) | ~jnp.asarray(self.certify)
            return state.y_eval, _Accepted(
                f_info,
                aux_eval,
                descent_state,
                stretch,
                decrease,
                model,
                near,
                threshold,
                still & exact_tried & ~convex,
                still & minimum,
            )

        y, now = jax.lax.cond(verdict.accept, accepted, lambda: (y, last))
        length = search.next_length(verdict)
        step, _ = self.model_descent.step(now.stretch * length, now.descent_state)
        promised = 2 * now.decrease * now.stretch * length
        goal = now.f_info.f - self.slope * promised
        at_rounding = verdict.shorter & (
            now.decrease <= self.noise * jnp.sqrt(jnp.abs(now.f_info.f))
        )
        now = eqx.tree_at(lambda a: a.done, now, now.done | at_rounding)
        kick = verdict.accept & now.saddle & self.certify
        next_search = search.after(verdict, y, f_eval, goal)
        next_search = eqx.tree_at(lambda s: s.forced, next_search, verdict.back | kick)

        def next_trial(y, step, reference):
            onward = jnp.where(
                at_rounding, y, y + step + jnp.where(kick, _kick(y), 0.0)
            )
            return jnp.where(verdict.back, reference, onward)

        stalled = verdict.shorter & (length < self.min_step)
        result = optx.RESULTS.where(
            stalled, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful
        )
        new_state = _NewtonState(
            y_eval=jtu.tree_map(next_trial, y, step, search.y),
            search=next_search,
            num_trials=state.num_trials + 1,
            accepted=now,
            num_accepted_steps=state.num_accepted_steps + verdict.accept,
            result=result,
        )
        return y, new_state, now.aux

    def _stretch(self, y, f_eval, state):
        """Curvatures along the step just made, s: of the objective, 2 (f' - f - g^T s); of
        the quadratic of decrease d behind it, (g^T s)^2 / 2d."""
        last = state.accepted
        slope = last.f_info.compute_grad_dot(
            jtu.tree_map(jnp.subtract, state.y_eval, y)
        )
        seen = 2 * (f_eval - last.f_info.f - slope)
        expected = slope**2 / (2 * jnp.where(slope == 0, 1.0, last.decrease))
        ratio = expected / jnp.maximum(seen, expected / self.longest)
        alike = (slope != 0) & ~state.search.forced
        return jnp.where(alike, jnp.maximum(ratio, 1.0), 1.0)

    def terminate(self, fn, y, args, options, state, tags):
        return state.accepted.done, state.result

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        last, best = state.accepted, state.search
        stats = {
            "num_newton_steps": state.num_accepted_steps,
            "num_trials": state.num_trials,
            "decrease": last.decrease,
            "objective": jnp.where(last.done, last.f_info.f - last.decrease, best.f),
        }
        # at the end the full Newton step is known already: take it
        y = jtu.tree_map(lambda a, b: jnp.where(last.done, a, b), state.y_eval, best.y)
        return y, aux, stats


def add_counts(stats: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """`stats` of a solve, with the steps of one before it."""
    counts = ("num_newton_steps", "num_trials", "num_steps")
    return {**stats, **{name: stats[name] + before[name] for name in counts}}


def _kick(y):
    """A small random displacement, always the same."""
    size = KICK * jnp.sqrt(jnp.mean(y**2))
    return size * jax.random.normal(jax.random.key(0), y.shape, y.dtype)


def _zeros(struct):
    is_struct = lambda x: isinstance(x, jax.ShapeDtypeStruct)
    fill = lambda x: jnp.zeros(x.shape, x.dtype) if is_struct(x) else x
    return jtu.tree_map(fill, struct, is_leaf=is_struct)
