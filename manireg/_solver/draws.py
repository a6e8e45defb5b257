"""Random maps of the posterior: what moves if data and prior are disturbed."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, ScalarLike

from .._objective.hessian import gauss_newton, weighted_residuals
from .._objective.problem import Problem, psi_jets
from .._objective.sites import Site, Stage, at_site, sites
from .._programs.program import program
from .linear import AbstractSolvers
from .minimise import projected_stage

AT_A_TIME = 64  # draws
# times the gauge, which is not disturbed: what is normal to N, which nothing else holds,
# stays zero, as far as the basis can follow. Rough as it would be, its derivatives would
# else turn up in velocities
STIFF = 1e4


def draws(
    problem: Problem,
    lam: ScalarLike,
    w: Float[Array, "KC t"],
    solvers: AbstractSolvers,
    key: PRNGKeyArray,
    m: int,
) -> Float[np.ndarray, "m KC t"]:
    r"""Of $N(0, H^{-1})$, H the Gauss-Newton model $2 \sum_q J_q^\top J_q$ at `w`:
    $H^{-1} g$, $g = \sqrt 2 \sum_q J_q^\top \xi_q$ with standard normal $\xi$ (perturb and
    optimise: Papandreou and Yuille 2010). No factor of H has to be known, and no matrix is
    dense."""
    hessian = _stiff_model(problem, lam, w)
    keys = jax.random.key_data(jax.random.split(key, -(-m // AT_A_TIME)))
    each = (_draws(problem, lam, w, hessian, solvers, one) for one in keys)
    return np.concatenate([np.asarray(part) for part in each])[:m]


def root(site: Site, stage: Stage, w: Float[Array, "KC t"]) -> Float[Array, "e p r"]:
    """Residuals whose squares are all that the objective sums up at the points of a site,
    rho' as it is at w."""
    of_point = weighted_residuals(site, stage)
    r = at_site(site, of_point, psi_jets(stage.problem, site.jets, w))
    # not beyond the elements that hold points, and nothing of their padding
    present = jnp.arange(len(r)) < site.jets.count
    scale = jnp.where(present[:, None], site.weights, 0.0)
    return jnp.sqrt(scale)[..., None] * jnp.where(scale[..., None] > 0, r, 0.0)


@program(most=4)
def _stiff_model(problem, lam, w):
    return gauss_newton(w, projected_stage(problem, lam, w, STIFF))


@program(most=4)
def _draws(problem, lam, w, hessian, solvers, key):
    stage = projected_stage(problem, lam, w, 0.0)
    roots = lambda w: [root(site, stage, w) for site in sites(stage)]
    values, pull = jax.vjp(roots, w)

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
