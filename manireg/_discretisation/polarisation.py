"""Symmetric tensors T of degree p, and the homogeneous polynomials T(v) = T(v, ..., v)
that they are: covariant derivatives are taken along geodesics, one direction at a time.

Components are those of the ascending indices, in the order of `partial_derivatives`.
"""

import functools

import numpy as np
from jaxtyping import Float

from .partial_derivatives import multiplicities, partial_derivatives, rows_of_order


@functools.cache
def directions(m: int, degree: int) -> Float[np.ndarray, "R m"]:
    """As many as there are components: (1), (1, 0), (1/2, 1/2), ..., the points of a
    lattice on a simplex, where a polynomial of that degree may be prescribed."""
    counts = [[d.count(a) for a in range(m)] for d in _components(m, degree)]
    return np.array(counts) / degree


@functools.cache
def jets_along(m: int, order: int) -> list[Float[np.ndarray, "R C"]]:
    """Of a map with known partial derivatives, the derivatives of degree 0, 1, ..., order
    along each of the `directions` of that order, as matrices on those of the degree."""
    v = directions(m, order)
    return [_powers(v, degree) for degree in range(order + 1)]


@functools.cache
def components(m: int, degree: int) -> Float[np.ndarray, "R R"]:
    """From the values in these directions to the components."""
    return np.linalg.inv(_powers(directions(m, degree), degree))


def _components(m: int, degree: int) -> tuple[tuple[int, ...], ...]:
    return partial_derivatives(m, degree)[rows_of_order(m, degree)]


def _powers(v: Float[np.ndarray, "R m"], degree: int) -> Float[np.ndarray, "R C"]:
    """What T(v) is of the components of T."""
    columns = [np.prod(v[:, list(d)], axis=1) for d in _components(v.shape[1], degree)]
    return np.stack(columns, axis=1) * multiplicities(v.shape[1], degree)
