"""Maps of space as linear functions of their coefficients: values, derivatives and bending
as sparse matrices, for many cheap solves on the host."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.sparse import csc_array, csr_array, diags_array, eye_array
from scipy.sparse.linalg import splu

from .._discretisation.jets import Jets, jets_of
from .._discretisation.partial_derivatives import multiplicities, rows_of_order
from .._objective.problem import Problem

RIDGE = 1e-7  # of the mean diagonal: what data and bending do not see does not move


class LinearMap(NamedTuple):
    r"""$\Psi = o + \sum_j w_j b_j$, j = 1..q, on an `Ambient` source."""

    origin: Float[np.ndarray, " 3"]
    values: csr_array
    """At the k data, `(k, q)`."""
    transposed: csr_array
    derivatives: tuple[csr_array, ...]
    """Along each axis of space, at the same points."""
    bending: csc_array
    r"""Q, `(q, q)`: $w^\top Q w = \int |D^2 \Psi|^2$, for a coordinate of Psi."""

    def at_data(self, w: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, "k 3"]:
        return self.origin + self.values @ w

    def normals(
        self, w: Float[np.ndarray, "q 3"], normals: Float[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, "k 3"]:
        r"""Unit normals of the image of a surface with the given ones at the data: the
        cofactors of $D\Psi$ times these. Of the map of space, not of the one onto the
        target, whose normals are the target's."""
        columns = [along @ w for along in self.derivatives]
        image = sum(
            normals[:, [a]] * np.cross(columns[a - 2], columns[a - 1]) for a in range(3)
        )
        length = np.linalg.norm(image, axis=1, keepdims=True)
        return image / np.maximum(length, np.finfo(float).tiny)

    def fitted(
        self,
        y: Float[np.ndarray, "k 3"],
        weights: Float[np.ndarray, " k"],
        lam: float,
        viscosity: float = 0.0,
        before: Float[np.ndarray, "q 3"] | None = None,
    ) -> Float[np.ndarray, "q 3"]:
        r"""The minimiser over w of

        $$\sum_i \omega_i |\Psi(x_i) - y_i|^2 + \lambda \int |D^2 \Psi|^2
          + \mu \int |D^2 (\Psi - \Psi_0)|^2$$

        with $\Psi_0$ the map of the coefficients `before` and mu the `viscosity`: lambda
        smooths the map, mu its change."""
        size = self.transposed.indptr.size - 1
        start = np.zeros((size, 3)) if before is None else before
        weighted = _times_rows(self.values, weights)
        data = csc_array(self.transposed @ weighted)
        ridge = RIDGE * data.diagonal().mean() * eye_array(len(start), format="csc")
        matrix = data + (lam + viscosity) * self.bending + ridge
        change = weighted.T @ (y - self.at_data(start)) - lam * (self.bending @ start)
        symmetric = {"SymmetricMode": True}
        factor = splu(matrix, "MMD_AT_PLUS_A", 0.0, options=symmetric)
        return start + factor.solve(change)


def _times_rows(matrix: csr_array, factors: Float[np.ndarray, " k"]) -> csr_array:
    """diag(factors) matrix."""
    data = matrix.data * np.repeat(factors, np.diff(matrix.indptr))
    return csr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)


def linear_map(problem: Problem) -> LinearMap:
    """That of a problem with an `Ambient` source in space."""
    x = np.asarray(problem.x)
    axes = np.broadcast_to(np.eye(3), (len(x), 3, 3))
    first = jets_of(problem.basis, np.concatenate([x[:, None], axes], axis=1), 1)
    size = problem.pattern.size
    along = tuple(_matrix(first, 1 + axis, size) for axis in range(3))
    values = _matrix(problem.data_jets, 0, size)
    return LinearMap(
        np.asarray(problem.origin),
        values,
        csr_array(values.T),
        along,
        _bending(problem, size),
    )


def _bending(problem: Problem, size: int) -> csc_array:
    jets = problem.energy_jets
    weights = _in_order(jets, np.asarray(problem.energy_weights))
    total = csc_array((size, size))
    second = range(*rows_of_order(3, 2).indices(jets.matrices.shape[2]))
    for row, times in zip(second, multiplicities(3, 2), strict=True):
        derivative = _matrix(jets, row, size)
        total = total + derivative.T @ diags_array(times * weights) @ derivative
    return csc_array(total)


def _in_order(jets: Jets, values: Float[np.ndarray, "e p"]) -> Float[np.ndarray, " Q"]:
    held = np.asarray(jets.mask) > 0
    index = np.asarray(jets.index)[held]
    ordered = np.zeros(np.max(index) + 1)
    ordered[index] = values[held]
    return ordered


def _matrix(jets: Jets, row: int, size: int) -> csr_array:
    """A row of the jets at all points, `(Q, size)`."""
    index, columns = np.asarray(jets.index), np.asarray(jets.columns)
    held = np.asarray(jets.mask) > 0
    # take the row first: all rows are ten times as many numbers
    entries = np.asarray(jets.matrices[:, :, row])
    there = held[:, :, None] & (columns[:, None, :] >= 0) & (entries != 0)
    rows = np.broadcast_to(index[:, :, None], entries.shape)[there]
    cols = np.broadcast_to(columns[:, None, :], entries.shape)[there]
    shape = int(np.max(index[held])) + 1, size
    return csr_array((entries[there], (rows, cols)), shape=shape)
