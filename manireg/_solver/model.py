"""The fitted map."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float

from .._discretisation.jets import centres_near
from .._discretisation.local_polynomials import (
    COVERED,
    LocalPolynomials,
    basis_values,
    cover,
)
from .._input.numbers import Numbers
from .._input.precision import check_x64
from .._objective.objective import Energies
from .._objective.problem import Problem
from .._programs.sizes import at_each
from .._source import AbstractSource
from .._sources.checks import check_inputs, is_concrete, projected
from ..manifolds import AbstractManifold
from .posterior import Posterior, posterior_of
from .summary import Summary, data_weights_of, summary_of


class RegressionMap(eqx.Module):
    """A fitted map from `source` to `target`: call it on new points."""

    source: AbstractSource
    target: AbstractManifold
    basis: LocalPolynomials
    origin: Float[Array, " t"]
    coefficients: Float[Array, "KC t"]
    """Of the basis, for what comes to `origin`."""
    lam: Float[Array, ""]
    energies: Energies
    result: optx.RESULTS
    stats: dict[str, Any]
    problem: Problem | None = None
    """What it was fitted to, for posteriors and summaries; None where the fit was traced
    (`jit`, `vmap`). `dataclasses.replace(model, problem=None)` is the map alone, in a
    small file."""

    __hash__ = object.__hash__  # `jax.jit(model)` asks for one

    def __call__(self, x: Numbers) -> Float[Array, "..."]:
        """Values at `x`, `(n, *source.point_shape)`: `(n, *target.point_shape)`, on the
        target. A single point, `(*source.point_shape)`, gives a single point, so
        `jax.vmap`, `jax.jit` and `jax.grad` take the model as it is.

        **Raises** ValueError for wrong shapes, NaN, points off the source or outside the
        cover of the fitted map, and for a model that was unpickled in float32 mode. Of
        traced `x` the values are not known: NaN and points outside an `Interval`, a `Box`
        or the cover are run-time errors (`equinox.error_if`); whether they lie on a curved
        source is not looked at: `source.project` them if in doubt.
        """
        check_x64(self.basis)
        flat, single = check_inputs(self.source, x)
        parts = self.basis, self.coefficients, self.origin
        if _is_host(self.target, parts, flat):
            near = centres_near(self.basis, np.asarray(flat))
            points, covered = at_each(_value, (self.target, *parts), flat, near)
            if not np.all(covered):
                raise ValueError(UNCOVERED)
            return jax.device_put(points[0] if single else points)
        values, covered = evaluate(self.basis, self.coefficients, flat, self.origin)
        values = eqx.error_if(values, ~covered, UNCOVERED)
        points = projected(self.target, values.reshape(-1, *self.target.point_shape))
        return points[0] if single else points

    def posterior(self) -> Posterior:
        """How sure the map is: covariances, regions, bands, random maps."""
        return posterior_of(self)

    def summary(self) -> Summary:
        """How it fits the data: what noise was found, how many parameters it took, which
        data are odd. `print` it, or read its fields."""
        return summary_of(self)

    @property
    def data_weights(self) -> Float[np.ndarray, " k"]:
        r"""What the loss leaves of each datum in the order of `y`: $\rho'(s_i)$, between 0
        and 1, of its squared residual s_i in units of the loss's scale; 1 for squares."""
        return data_weights_of(self)


UNCOVERED = (
    "x: some points lie outside the support of every centre of the fitted map; fit with "
    "inputs that cover them."
)


def evaluate(
    basis: LocalPolynomials,
    w: Float[Array, "KC t"],
    x: Float[Array, "n s"],
    origin: Float[Array, " t"],
) -> tuple[Float[Array, "n t"], Bool[Array, ""]]:
    """Psi at `x`, before the projection to N; and whether all of `x` is covered. Traced
    points are compared with all centres, others only with those near them."""
    owner = basis, w, origin
    if _is_host(owner, x):
        near = centres_near(basis, np.asarray(x))
        values, covered = at_each(_psi, owner, x, near)
        return jax.device_put((values, np.all(covered)))
    return _evaluate_traced(owner, x)


@eqx.filter_jit
def _evaluate_traced(owner, x):
    """A loop outside of `jit` would be compiled at every call."""
    everywhere = jnp.arange(len(owner[0].centres))
    one = lambda x: _psi(owner, x, everywhere)
    values, covered = jax.lax.map(one, x, batch_size=256)
    return values, jnp.all(covered)


def _is_host(*values) -> bool:
    return is_concrete(*jax.tree.leaves(values))


def _psi(owner, x, near):
    basis, w, origin = owner
    w = w.reshape(len(basis.centres), basis.size, -1)
    values = basis_values(basis, x, near).reshape(len(near), -1)
    psi = jnp.einsum("lc,lct->t", values, w[near])
    return origin + psi, cover(basis, x, near) > COVERED


def _value(owner, x, near):
    target, *parts = owner
    psi, covered = _psi(parts, x, near)
    return target.project(psi.reshape(target.point_shape)), covered


def regression_map(
    problem: Problem, w: Float[Array, "KC t"], lam, energies, result, stats
) -> RegressionMap:
    """The map with coefficients `w`."""
    source, target, basis = problem.source, problem.target, problem.basis
    fit = problem.origin, w, lam, energies, result, stats
    known = is_concrete(*jax.tree.leaves((problem, w)))
    return RegressionMap(source, target, basis, *fit, problem if known else None)
