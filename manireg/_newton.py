"""A Newton minimiser in optimistix's form: loop x descent x search.

optimistix has no Newton minimiser, so this composes one from its parts: the loop below,
`optx.NewtonDescent` for the direction, `optx.BacktrackingArmijo` for the step. Hessians
are functions of their own, `(y, args) -> lineax operator`, because they are assembled
sparse; the exact one is also given the last model, `(y, args, model)`. Far from the
minimum a Gauss-Newton model, always positive definite, gives the direction; near it the
exact Hessian, whose convergence is quadratic (measured on curves: 7..15 steps in place of
8..60).
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import optimistix as optx
from jaxtyping import Array, Bool, Int, Scalar


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
    done: Bool[Array, ""]


class _NewtonState(eqx.Module):
    # updated every search step
    first_step: Bool[Array, ""]
    y_eval: Any
    search_state: Any
    shortened: Bool[Array, ""]
    num_trials: Int[Array, ""]
    # updated after every accepted step
    accepted: _Accepted
    num_accepted_steps: Int[Array, ""]
    result: optx.RESULTS


class Newton(optx.AbstractMinimiser):
    """Newton's method with Armijo backtracking (paper, section 4).

    **Arguments:**

    - `rtol`, `atol`: stop when the decrease predicted by the full Newton step,
      half of g^T H^{-1} g, is below `atol + rtol |f|`.
    - `model_hessian`, `model_descent`: the positive definite model, and the descent that
      holds its linear solver.
    - `exact_hessian`, `exact_descent`: the same for the exact Hessian, tried once the
      predicted decrease has come below `near |f|`, and taken if it points downhill. Where
      such a step has to be shortened, the minimum is flat or not near yet: the model goes
      on until the decrease is `retry` times smaller (measured on curves under large
      lambdas: 20 to 40 trials in place of 256 and no end).
    - `search`: the step size rule; lengths are shares of the Newton step, of the model's
      times the `stretch` below.
    - `longest`: the model overestimates the curvature where the residuals curve back. A
      step along the model's direction is stretched by the model's curvature over the
      objective's, seen along the last step, from 1 to at most `longest` (measured on
      curves: a quarter less time, half in the worst cases).
    - `min_step`: give up (`nonlinear_divergence`) when backtracking goes below it.
    """

    rtol: float
    atol: float
    model_hessian: Callable
    exact_hessian: Callable
    model_descent: optx.AbstractDescent
    exact_descent: optx.AbstractDescent
    search: optx.AbstractSearch = optx.BacktrackingArmijo(slope=1e-4)
    norm: Callable[[Any], Scalar] = optx.max_norm
    near: float = 1e-3
    retry: float = 0.1
    longest: float = 4.0
    min_step: float = 1e-8

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        grad = jax.eval_shape(lambda: y)
        f_info = optx.FunctionInfo.EvalGrad(f_struct, grad)
        hessian = eqx.filter_eval_shape(self.model_hessian, y, args)
        with_hessian = optx.FunctionInfo.EvalGradHessian(f_struct, grad, hessian)
        return _NewtonState(
            first_step=jnp.array(True),
            y_eval=y,
            search_state=self.search.init(y, f_info),
            shortened=jnp.array(False),
            num_trials=jnp.array(0),
            accepted=_Accepted(
                f_info=_zeros(f_info),
                aux=_zeros(aux_struct),
                descent_state=self.model_descent.init(y, with_hessian),
                stretch=jnp.ones(()),
                decrease=jnp.zeros(()),
                model=_zeros(hessian),
                near=jnp.array(False),
                threshold=jnp.asarray(self.near, f_struct.dtype),
                done=jnp.array(False),
            ),
            num_accepted_steps=jnp.array(0),
            result=optx.RESULTS.successful,
        )

    def step(self, fn, y, args, options, state, tags):
        last = state.accepted
        f_eval, vjp, aux_eval = jax.vjp(
            lambda y: fn(y, args), state.y_eval, has_aux=True
        )
        step_size, accept, search_result, search_state = self.search.step(
            state.first_step,
            y,
            state.y_eval,
            last.f_info,
            optx.FunctionInfo.Eval(f_eval),
            state.search_state,
        )

        def accepted():
            (grad,) = vjp(jnp.ones_like(f_eval))
            f_info = optx.FunctionInfo.EvalGrad(f_eval, grad)

            def query(descent, hessian):
                info = optx.FunctionInfo.EvalGradHessian(f_eval, grad, hessian)
                new_state = descent.query(state.y_eval, info, last.descent_state)
                step, result = descent.step(jnp.ones_like(f_eval), new_state)
                decrease = -0.5 * f_info.compute_grad_dot(step)
                solved = result == optx.RESULTS.successful
                return new_state, jnp.where(solved, decrease, -1.0)

            def query_exact():
                hessian = self.exact_hessian(state.y_eval, args, last.model)
                return *query(self.exact_descent, hessian), last.model

            def query_model():
                hessian = self.model_hessian(state.y_eval, args)
                return *query(self.model_descent, hessian), hessian

            exact = jax.lax.cond(
                last.near & ~state.shortened,
                query_exact,
                lambda: (last.descent_state, jnp.full_like(f_eval, -1.0), last.model),
            )
            downhill = jnp.isfinite(exact[1]) & (exact[1] > 0)
            descent_state, decrease, model = jax.lax.cond(
                downhill, lambda: exact, query_model
            )
            threshold = jnp.where(
                last.near & state.shortened,
                self.retry * decrease / jnp.abs(f_eval),
                last.threshold,
            )
            near = decrease < threshold * jnp.abs(f_eval)
            stretch = jnp.where(downhill, 1.0, self._stretch(y, f_eval, state))
            rounding = 8 * jnp.finfo(f_eval.dtype).eps * jnp.abs(f_eval)
            tolerance = self.atol + self.rtol * jnp.abs(f_eval) + rounding
            done = decrease <= tolerance
            return state.y_eval, _Accepted(
                f_info,
                aux_eval,
                descent_state,
                stretch,
                decrease,
                model,
                near,
                threshold,
                done,
            )

        y, now = jax.lax.cond(accept, accepted, lambda: (y, last))
        length = now.stretch * step_size
        step, descent_result = self.model_descent.step(length, now.descent_state)
        result = optx.RESULTS.where(
            search_result == optx.RESULTS.successful, descent_result, search_result
        )
        stalled = ~accept & (step_size < self.min_step)
        result = optx.RESULTS.where(stalled, optx.RESULTS.nonlinear_divergence, result)
        new_state = _NewtonState(
            first_step=jnp.array(False),
            y_eval=jtu.tree_map(jnp.add, y, step),
            search_state=search_state,
            shortened=~accept,
            num_trials=state.num_trials + 1,
            accepted=now,
            num_accepted_steps=state.num_accepted_steps + accept,
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
        return jnp.where(slope == 0, 1.0, jnp.maximum(ratio, 1.0))

    def terminate(self, fn, y, args, options, state, tags):
        return state.accepted.done, state.result

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        last = state.accepted
        stats = {
            "num_newton_steps": state.num_accepted_steps,
            "num_trials": state.num_trials,
            "objective": last.f_info.f - jnp.where(last.done, last.decrease, 0.0),
        }
        # at the end the full Newton step is known already: take it
        y = jtu.tree_map(lambda a, b: jnp.where(last.done, a, b), state.y_eval, y)
        return y, aux, stats


def add_counts(stats: dict[str, Any], before: dict[str, Any]) -> dict[str, Any]:
    """`stats` of a solve, with the steps of one before it."""
    counts = ("num_newton_steps", "num_trials", "num_steps")
    return {**stats, **{name: stats[name] + before[name] for name in counts}}


def _zeros(struct):
    is_struct = lambda x: isinstance(x, jax.ShapeDtypeStruct)
    fill = lambda x: jnp.zeros(x.shape, x.dtype) if is_struct(x) else x
    return jtu.tree_map(fill, struct, is_leaf=is_struct)
