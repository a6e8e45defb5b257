"""Random maps of the posterior: what moves if data and prior are disturbed."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from .._objective.hessian import gauss_newton, weighted_residuals
from .._objective.problem import Problem, psi_jets
from .._objective.sites import Stage, at_site, sites
from .._programs.program import program
from .linear import AbstractSolvers

AT_A_TIME = 64  # draws
# times the gauge, which is not disturbed: what is normal to N, which nothing else holds,
# stays zero, as far as the basis can follow. Rough as it would be, its derivatives would
# else turn up in velocities
STIFF = 1e4


def draws(
    stage: Stage,
    w: Float[Array, "KC t"],
    solvers: AbstractSolvers,
    key: PRNGKeyArray,
    m: int,
) -> Float[np.ndarray, "m KC t"]:
    r"""Of $N(0, H^{-1})$, H the Gauss-Newton model $2 \sum_q J_q^\top J_q$ at `w`:
    $H^{-1} g$, $g = \sqrt 2 \sum_q J_q^\top \xi_q$ with standard normal $\xi$ (perturb and
    optimise: Papandreou and Yuille 2010). No factor of H has to be known, and no matrix is
    dense."""
    stage = eqx.tree_at(lambda s: s.gamma, stage, STIFF * stage.gamma)
    hessian = _model(w, stage)
    keys = jax.random.key_data(jax.random.split(key, -(-m // AT_A_TIME)))
    parts = [np.asarray(_draws(stage, w, hessian, solvers, one)) for one in keys]
    return np.concatenate(parts)[:m]


_model = program(most=4)(gauss_newton)


@program(most=4)
def _draws(stage, w, hessian, solvers, key):
    problem: Problem = stage.problem
    stage = eqx.tree_at(lambda s: s.gamma, stage, jnp.zeros_like(stage.gamma))

    def residuals(w):
        """Square roots of all that the objective sums up, but for the gauge."""
        both = []
        for site in sites(stage):
            of_point = weighted_residuals(site, stage)
            r = at_site(site, of_point, psi_jets(problem, site.jets, w))
            # not beyond the elements that hold points, and nothing of their padding
            present = jnp.arange(len(r)) < site.jets.count
            scale = jnp.where(present[:, None], site.weights, 0.0)
            some = jnp.where(scale[..., None] > 0, r, 0.0)
            both.append(jnp.sqrt(scale)[..., None] * some)
        return both

    values, pull = jax.vjp(residuals, w)

    def disturbed(key):
        keys = jax.random.split(key, len(values))
        normal = [jax.random.normal(k, r.shape) for k, r in zip(keys, values)]
        return np.sqrt(2.0) * pull(normal)[0]

    keys = jax.random.split(jax.random.wrap_key_data(key), AT_A_TIME)
    sides = jax.vmap(disturbed)(keys)
    solve = functools.partial(solvers.positive.compute, options={})
    factor = solvers.positive.init(hessian, {})
    found = solve(factor, jnp.moveaxis(sides, 0, -1))[0]
    return jnp.moveaxis(found, -1, 0)
