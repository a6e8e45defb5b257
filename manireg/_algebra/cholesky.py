"""Cholesky solvers of the Newton system, each a lineax solver of its own: a band one on
curves, CHOLMOD through sparsax on surfaces, a dense one for a GPU there and for checks.

They add `ridge` times the diagonal. It moves only directions the objective hardly sees
(the gauge of the basis), and it is a term of the Newton step, not of the objective: the
minimiser stays where it is.
"""

import abc
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import lineax as lx
import sparsax
from jaxtyping import Array, Float, Int

from .banded import solve_banded, window_factors
from .covariances import Elements, from_halves, from_windows
from .sparse import SparseSymmetric

RIDGES = (1e-14, 1e-12, 1e-10)  # times the diagonal, tried in turn
LEAST = 1e-14  # times the largest number on the diagonal: what is less is zero


class AbstractDirect(lx.AbstractLinearSolver):
    """Of symmetric operators of full rank."""

    def transpose(self, state, options):
        return state, options

    def conj(self, state, options):
        return state, options

    def assume_full_rank(self):
        return True


class AbstractPositive(AbstractDirect):
    """Of positive definite ones."""

    @abc.abstractmethod
    def covariances(
        self, operator: SparseSymmetric, elements: Elements, joint: bool = False
    ) -> Float[Array, "..."]:
        """A H^{-1} A^T for the operator H, at each point with the values A that it has in
        the unknowns, `(e, p, t, t)`: never a whole inverse. With `joint` of the points of
        each element together, `(e, p, t, p, t)`."""


class SparseCholesky(AbstractPositive):
    """CHOLMOD. The operator has to be positive definite up to `ridge`: sparsax raises
    otherwise. It keeps the analysis and the last factor of each list of indices, and
    takes that factor where the values are the same. So that fits on several devices do
    not evict each other's, each device has a list of its own."""

    # Not `sparsax.factor`, whose factors (0.9) are never freed: one a Newton step. After
    # `set_num_cache_size`, which does not cap but cut them, a token may silently stand for
    # the factor of another matrix.

    ridge: float = 1e-12

    def init(self, operator, options):
        del options
        operator = _sparse(operator)
        scale = _scale(operator)
        i, j = operator.coordinates()
        values = _regular_blocks(operator, scale, self.ridge)
        entries = _of_this_device(i.ravel(), j.ravel(), values.ravel(), scale.size)
        return entries, scale

    def compute(self, state, vector, options):
        (i, j, values), scale = state
        solution = sparsax.solve(i, j, values, _flat(scale, vector))
        return _unflat(scale, vector, solution), lx.RESULTS.successful, {}

    def covariances(self, operator, elements, joint=False):
        (i, j, values), scale = self.init(operator, {})

        def half(sides):
            permuted = sparsax.solve(i, j, values, _flat(scale, sides), sparsax.MODE_P)
            return sparsax.solve(i, j, values, permuted, sparsax.MODE_L)

        return from_halves(half, operator.in_structure().shape, elements, joint)


class BandCholesky(AbstractPositive):
    """For the neighbours on a curve. No callback. The ridge is the first of `RIDGES` that
    makes the operator positive definite to rounding; where none does, the solution is not
    a number."""

    def init(self, operator: Any, options):
        del options
        pattern, blocks = operator.pattern, operator.blocks
        shape = (pattern.centres, pattern.band, *blocks.shape[1:])
        places = pattern.rows, pattern.cols - pattern.rows
        columns = jnp.zeros(shape).at[places].set(jnp.swapaxes(blocks, 1, 2))
        size = jnp.abs(operator.diagonal()).reshape(pattern.centres, 1, -1)
        return columns, jnp.maximum(size, LEAST * jnp.max(size))

    def compute(self, state, vector, options):
        columns, size = state
        n, _, m, _ = columns.shape
        rhs = jnp.swapaxes(vector.reshape(n, m, -1), 1, 2)
        solve = lambda ridge: solve_banded(_ridged(columns, size, ridge), rhs)
        solution = jnp.swapaxes(first_finite(solve, RIDGES, rhs)[0], 1, 2)
        return solution.reshape(vector.shape), lx.RESULTS.successful, {}

    def covariances(self, operator, elements, joint=False):
        columns, size = self.init(operator, {})
        n, band, m, _ = columns.shape
        factors = first_finite(
            lambda ridge: window_factors(_ridged(columns, size, ridge)),
            RIDGES,
            jnp.zeros((n, band * m, band * m)),
        )[0]
        return from_windows(factors, band, elements, joint)


def _ridged(columns: Float[Array, "n band m m"], size, ridge):
    return columns.at[:, 0].add(ridge * size * jnp.eye(columns.shape[-1]))


class DenseCholesky(AbstractPositive):
    """The same of a whole matrix."""

    def init(self, operator, options):
        del options
        return _dense(operator)

    def compute(self, state, vector, options):
        matrix, scale = state
        factor = _lower(matrix), True
        solution = jax.scipy.linalg.cho_solve(factor, _flat(scale, vector))
        return _unflat(scale, vector, solution), lx.RESULTS.successful, {}

    def covariances(self, operator, elements, joint=False):
        matrix, scale = self.init(operator, {})
        solve = functools.partial(
            jax.scipy.linalg.solve_triangular, _lower(matrix), lower=True
        )
        half = lambda sides: solve(_flat(scale, sides))
        return from_halves(half, operator.in_structure().shape, elements, joint)


def _lower(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    def factor(ridge):
        ridged = matrix + ridge * jnp.eye(len(matrix))
        return jax.lax.linalg.cholesky(ridged, symmetrize_input=False)

    return first_finite(factor, RIDGES, matrix)[0]


def first_finite(
    solve: Callable, amounts: tuple[float, ...], like: Array
) -> tuple[Array, Array]:
    """`solve` of the first of `amounts` that gives numbers, and how many were tried."""
    each = jnp.array(amounts)

    def attempt(carry):
        _, tries = carry
        return solve(each[tries]), tries + 1

    def indefinite(carry):
        x, tries = carry
        return (tries < len(amounts)) & ~jnp.all(jnp.isfinite(x))

    start = (jnp.full_like(like, jnp.nan), jnp.array(0))
    return jax.lax.while_loop(indefinite, attempt, start)


def _sparse(operator: lx.AbstractLinearOperator) -> SparseSymmetric:
    if not isinstance(operator, SparseSymmetric):
        raise TypeError(f"expected a SparseSymmetric, found {type(operator).__name__}.")
    return operator


def _scale(operator: SparseSymmetric):
    return _inverse_root(operator.diagonal())


def _inverse_root(diagonal):
    size = jnp.abs(diagonal)
    # of a zero matrix, too: under vmap both sides of a branch are computed
    least = jnp.maximum(LEAST * jnp.max(size), 1e-300)
    return jax.lax.rsqrt(jnp.maximum(size, least))


def _flat(scale: Float[Array, "size t"], vector: Float[Array, "size t *sides"]):
    """Scaled right-hand side, or several: `(size t, *sides)`."""
    sides = vector.shape[2:]
    return scale.reshape(-1, *(1 for _ in sides)) * vector.reshape(-1, *sides)


def _unflat(scale, vector, solution):
    sides = vector.shape[2:]
    scaled = scale.reshape(-1, *(1 for _ in sides)) * solution
    return scaled.reshape(vector.shape)


def _regular_blocks(operator: SparseSymmetric, scale, ridge: float):
    """Of the scaled matrix, `ridge` added to its diagonal."""
    scale = scale.reshape(operator.pattern.centres, -1)
    rows, cols = operator.pattern.rows, operator.pattern.cols
    blocks = operator.blocks * scale[rows][:, :, None] * scale[cols][:, None, :]
    own = (rows == cols)[:, None, None]
    return blocks + ridge * own * jnp.eye(blocks.shape[-1])


def _of_this_device(
    i: Int[Array, " n"], j: Int[Array, " n"], values: Float[Array, " n"], size: int
) -> tuple[Int[Array, " n+1"], Int[Array, " n+1"], Float[Array, " n+1"]]:
    """The same matrix with one more entry, first. It lies below the diagonal, where
    sparsax ignores values, and its row is the number of the device in a `shard_map`."""
    axes = tuple(jax.sharding.get_abstract_mesh().manual_axes)
    device = jax.lax.axis_index(axes) if axes else jnp.array(0)
    row = (1 + device % (size - 1)).astype(i.dtype)
    return (
        jnp.concatenate([row[None], i]),
        jnp.concatenate([jnp.zeros_like(row)[None], j]),
        jnp.concatenate([jnp.zeros_like(values[:1]), values]),
    )


def _dense(operator: lx.AbstractLinearOperator):
    matrix = operator.as_matrix()
    scale = _inverse_root(jnp.diagonal(matrix))
    shape = operator.in_structure().shape
    return matrix * scale[:, None] * scale[None, :], scale.reshape(shape)
