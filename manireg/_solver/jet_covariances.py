"""Covariances of what a map is at new points - values, velocities, and any function of
its jets there."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from .._discretisation.jets import centres_near, columns_of
from .._discretisation.local_polynomials import LocalPolynomials, basis_values
from .._programs.sizes import at_each
from .derivatives import curve_jet, of_psi
from .directions import curved
from .evaluation import Function, nearby


class JetsAt(NamedTuple):
    """Of a map at q points: values, or values and derivatives along a curve."""

    rows: Float[np.ndarray, "q J LC"]
    """From the coefficients of the centres near each."""
    near: Int[np.ndarray, "q L"]
    psi: Float[np.ndarray, "q J t"]

    def as_matrix(self, size: int) -> csr_array:
        """The values `(q, K C)` of all basis functions."""
        values, functions = self.rows[:, 0], self.rows.shape[2] // self.near.shape[1]
        columns = columns_of(self.near, functions)
        point, entry = np.nonzero(columns >= 0)
        places = point, columns[point, entry]
        return csr_array((values[point, entry], places), shape=(len(values), size))


def jets_at(model: Any, flat: Float[np.ndarray, "q s"], order: int) -> JetsAt:
    """Of a `RegressionMap`, at ambient coordinates; above order 0 along a source of
    dimension 1."""
    basis = model.basis
    near = centres_near(basis, flat)
    along = _Along(curved(model.source), order) if order else _Along(None, 0)
    rows = at_each(_rows, (basis, along), flat, near)
    owner = basis, model.coefficients, model.origin
    return JetsAt(rows, near, at_each(_psi, owner, rows, near))


def displaced(
    jets: JetsAt, basis: LocalPolynomials, dw: Float[np.ndarray, "KC t"]
) -> Float[np.ndarray, "q Jt"]:
    """How the jets move with the coefficients."""
    owner = basis, dw, np.zeros(dw.shape[1])
    return at_each(_psi, owner, jets.rows, jets.near).reshape(len(jets.rows), -1)


def pushed(
    function: Callable,
    owner: Any,
    jets: JetsAt,
    covariance: Float[np.ndarray, "q Jt Jt"],
    *arrays: np.ndarray,
) -> tuple[Any, Float[np.ndarray, "q d d"]]:
    """`function(owner, jet, *arrays)` at each point, and to first order the covariance of
    its flattened value. `function` has to be the same object at every call."""
    asked = Function(function), owner
    values, slopes = at_each(_with_slope, asked, jets.psi, *arrays)
    return values, slopes @ covariance @ np.swapaxes(slopes, 1, 2)


class _Along(eqx.Module):
    source: Any
    order: int = eqx.field(static=True)


def _rows(owner, x, near):
    basis, along = owner
    if along.order == 0:
        return basis_values(basis, x, near)[None]
    return curve_jet(basis, along.source, x, near, along.order)


def _psi(owner, rows, near):
    basis: LocalPolynomials
    basis, w, origin = owner
    return of_psi(rows, nearby(basis, w, near), origin)


def _with_slope(asked, psi, *arrays):
    function, owner = asked
    value = lambda psi: jnp.ravel(function.call(owner, psi, *arrays))
    slope = jax.jacfwd(value)(psi)
    return function.call(owner, psi, *arrays), slope.reshape(len(slope), -1)
