"""A Newton minimiser in optimistix's form: loop x descent x search.

optimistix has no Newton minimiser, so this composes one from its parts: the loop below,
`optx.NewtonDescent` for the direction, `optx.BacktrackingArmijo` for the step. The
Hessian is a function of its own, `hessian(y, args) -> lineax operator`, because it is
assembled sparse; it has to be positive definite (a Gauss-Newton model).
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import optimistix as optx
from jaxtyping import Array, Bool, Int, Scalar


class _NewtonState(eqx.Module):
    # updated every search step
    first_step: Bool[Array, ""]
    y_eval: Any
    search_state: Any
    num_trials: Int[Array, ""]
    # updated after every accepted step
    f_info: optx.FunctionInfo.EvalGrad
    aux: Any
    descent_state: Any
    num_accepted_steps: Int[Array, ""]
    # used for termination
    terminate: Bool[Array, ""]
    result: optx.RESULTS


class Newton(optx.AbstractMinimiser):
    """Newton's method with Armijo backtracking (paper, section 4).

    **Arguments:**

    - `rtol`, `atol`: stop when the full Newton step is below `atol + rtol |y|` in `norm`,
      or when the decrease it predicts is below what rounding of f can resolve.
    - `hessian`: `(y, args) -> lx.AbstractLinearOperator`, positive definite.
    - `descent`: holds the linear solver.
    - `search`: the step size rule.
    - `min_step`: give up (`nonlinear_divergence`) when backtracking goes below it.
    """

    rtol: float
    atol: float
    hessian: Callable
    descent: optx.AbstractDescent
    search: optx.AbstractSearch = optx.BacktrackingArmijo(slope=1e-4)
    norm: Callable[[Any], Scalar] = optx.max_norm
    min_step: float = 1e-8

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        grad = jax.eval_shape(lambda: y)
        f_info = optx.FunctionInfo.EvalGrad(f_struct, grad)
        hessian = eqx.filter_eval_shape(self.hessian, y, args)
        with_hessian = optx.FunctionInfo.EvalGradHessian(f_struct, grad, hessian)
        return _NewtonState(
            first_step=jnp.array(True),
            y_eval=y,
            search_state=self.search.init(y, f_info),
            num_trials=jnp.array(0),
            f_info=_zeros(f_info),
            aux=_zeros(aux_struct),
            descent_state=self.descent.init(y, with_hessian),
            num_accepted_steps=jnp.array(0),
            terminate=jnp.array(False),
            result=optx.RESULTS.successful,
        )

    def step(self, fn, y, args, options, state, tags):
        f_eval, vjp, aux_eval = jax.vjp(
            lambda y: fn(y, args), state.y_eval, has_aux=True
        )
        step_size, accept, search_result, search_state = self.search.step(
            state.first_step,
            y,
            state.y_eval,
            state.f_info,
            optx.FunctionInfo.Eval(f_eval),
            state.search_state,
        )

        def accepted(descent_state):
            (grad,) = vjp(jnp.ones_like(f_eval))
            f_info = optx.FunctionInfo.EvalGrad(f_eval, grad)
            hessian = self.hessian(state.y_eval, args)
            with_hessian = optx.FunctionInfo.EvalGradHessian(f_eval, grad, hessian)
            descent_state = self.descent.query(
                state.y_eval, with_hessian, descent_state
            )
            # The full step is tested, not the backtracked one: a tiny step size must not
            # pass for convergence. Near the minimum Armijo compares differences of f that
            # are rounding only; the second test stops before.
            full, _ = self.descent.step(jnp.ones_like(f_eval), descent_state)
            scaled = jtu.tree_map(
                lambda d, y: d / (self.atol + self.rtol * jnp.abs(y)), full, y
            )
            decrease = -0.5 * f_info.compute_grad_dot(full)
            floor = 8 * jnp.finfo(f_eval.dtype).eps * jnp.abs(f_eval)
            done = (self.norm(scaled) < 1) | ((decrease >= 0) & (decrease <= floor))
            return state.y_eval, f_info, aux_eval, descent_state, done

        def rejected(descent_state):
            return y, state.f_info, state.aux, descent_state, jnp.array(False)

        y, f_info, aux, descent_state, terminate = jax.lax.cond(
            accept, accepted, rejected, state.descent_state
        )
        step, descent_result = self.descent.step(step_size, descent_state)
        result = optx.RESULTS.where(
            search_result == optx.RESULTS.successful, descent_result, search_result
        )
        stalled = ~accept & (step_size < self.min_step)
        result = optx.RESULTS.where(
            stalled, optx.RESULTS.nonlinear_divergence, result
        )
        new_state = _NewtonState(
            first_step=jnp.array(False),
            y_eval=jtu.tree_map(jnp.add, y, step),
            search_state=search_state,
            num_trials=state.num_trials + 1,
            f_info=f_info,
            aux=aux,
            descent_state=descent_state,
            num_accepted_steps=state.num_accepted_steps + accept,
            terminate=terminate,
            result=result,
        )
        return y, new_state, aux

    def terminate(self, fn, y, args, options, state, tags):
        return state.terminate, state.result

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        stats = {
            "num_newton_steps": state.num_accepted_steps,
            "num_trials": state.num_trials,
        }
        return y, aux, stats


def _zeros(struct):
    is_struct = lambda x: isinstance(x, jax.ShapeDtypeStruct)
    fill = lambda x: jnp.zeros(x.shape, x.dtype) if is_struct(x) else x
    return jtu.tree_map(fill, struct, is_leaf=is_struct)
