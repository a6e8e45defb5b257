"""Functions of the coefficients of a map at new points, of which each needs only those of
the centres near it: found on the host, or of traced points inside the program."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

from .._discretisation.jets import centres_near
from .._discretisation.local_polynomials import (
    COVERED,
    LocalPolynomials,
    basis_values,
    cover,
)
from .._discretisation.supports import most_supports, supports_at
from .._programs.sizes import at_each
from .._sources.checks import is_concrete

UNCOVERED = (
    "x: some points lie outside the support of every centre of the fitted map; fit with "
    "inputs that cover them."
)


def at_covered(
    function: Callable, basis: LocalPolynomials, owner: PyTree, x: Float[Array, "n s"]
) -> PyTree:
    """`function((basis, owner), x, near)` at every point. **Raises** ValueError where no
    centre reaches, a run-time error for traced points."""
    values, covered = at_points(function, basis, owner, x)
    if is_concrete(covered):
        if not covered:
            raise ValueError(UNCOVERED)
        return values
    return eqx.error_if(values, ~covered, UNCOVERED)


def at_points(
    function: Callable, basis: LocalPolynomials, owner: PyTree, x: Float[Array, "n s"]
) -> tuple[PyTree, Bool[Any, ""]]:
    """The same; and whether all of `x` is covered. `function` has to be the same object at
    every call, or it is compiled again."""
    if is_concrete(*jax.tree.leaves((basis, owner, x))):
        near = centres_near(basis, np.asarray(x))
        asked = Function(function), basis, owner
        values, covered = at_each(_at_point, asked, x, near)
        return jax.device_put(values), np.all(covered)
    known = is_concrete(*jax.tree.leaves(basis))
    most = most_supports(basis) if known else len(basis.centres)
    return _evaluate_traced((Function(function), basis, owner), x, most)


class Function(eqx.Module):
    """To be handed to programs among their arguments."""

    call: Callable = eqx.field(static=True)


@eqx.filter_jit
def _evaluate_traced(asked, x, most: int):
    """A loop outside of `jit` would be compiled at every call."""
    one = lambda x: _at_point(asked, x, supports_at(asked[1], x, most))
    values, covered = jax.lax.map(one, x, batch_size=256)
    return values, jnp.all(covered)


def _at_point(asked, x, near):
    function, basis, owner = asked
    values = function.call((basis, owner), x, near)
    return values, cover(basis, x, near) > COVERED


def evaluate(
    basis: LocalPolynomials,
    w: Float[Array, "KC t"],
    x: Float[Array, "n s"],
    origin: Float[Array, " t"],
) -> tuple[Float[Array, "n t"], Bool[Array, ""]]:
    """Psi at `x`, before the projection to N; and whether all of `x` is covered."""
    values, covered = at_points(psi_at, basis, (w, origin), x)
    return values, jnp.asarray(covered)


def psi_at(owner, x, near):
    basis, (w, origin) = owner
    return origin + basis_values(basis, x, near) @ nearby(basis, w, near)


def nearby(
    basis: LocalPolynomials, w: Float[Array, "KC t"], near
) -> Float[Array, "LC t"]:
    """The coefficients of the centres `near`; at -1, padding, any."""
    t = w.shape[1]
    return w.reshape(len(basis.centres), basis.size, t)[near].reshape(-1, t)
