"""Solvers of the Newton system, each a lineax solver of its own: a band Cholesky on
curves, CHOLMOD through sparsax on surfaces, dense ones for a GPU there and for checks.

The Cholesky ones add `ridge` times the diagonal. It moves only directions the objective
hardly sees (the gauge of the basis), and it is a term of the Newton step, not of the
objective: the minimiser stays where it is.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import sparsax
from jaxtyping import Array, Float

from ._block_banded import solve_banded
from ._sparse import SparseSymmetric

RIDGES = (1e-14, 1e-12, 1e-10)  # times the diagonal, tried in turn
SHIFTS = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)  # times the model, by `LeastShift`
LEAST = 1e-14  # times the largest number on the diagonal: what is less is zero


class _AbstractDirect(lx.AbstractLinearSolver):
    def transpose(self, state, options):
        return state, options

    def conj(self, state, options):
        return state, options

    def assume_full_rank(self):
        return True


class SparseCholesky(_AbstractDirect):
    """CHOLMOD; the symbolic analysis is cached per pattern. The operator has to be
    positive definite up to `ridge`: sparsax raises otherwise."""

    ridge: float = 1e-12

    def init(self, operator, options):
        del options
        operator = _sparse(operator)
        scale = _scale(operator)
        i, j = operator.coordinates()
        values = _regular_blocks(operator, scale, self.ridge)
        return i.ravel(), j.ravel(), values.ravel(), scale

    def compute(self, state, vector, options):
        i, j, values, scale = state
        solution = sparsax.solve(i, j, values, _flat(scale, vector))
        return _unflat(scale, vector, solution), lx.RESULTS.successful, {}


class BandCholesky(_AbstractDirect):
    """For the neighbours on a curve. No callback. The ridge is the first of `RIDGES` that
    makes the operator positive definite to rounding; where none does, the solution is not
    a number."""

    def init(self, operator: SparseSymmetric, options):
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

        def solve(ridge):
            regular = columns.at[:, 0].add(ridge * size * jnp.eye(m))
            return solve_banded(regular, rhs)

        solution = jnp.swapaxes(_with_least_ridge(solve, rhs), 1, 2)
        return solution.reshape(vector.shape), lx.RESULTS.successful, {}


class ModelCG(_AbstractDirect):
    """Conjugate gradients for an operator that may be indefinite (the exact Hessian),
    preconditioned by the factor of its positive definite `model`. On surfaces a
    factorisation is dear and LU ten times dearer; a dozen products and solves are not,
    and the factor is that of an earlier Newton step. Where the curvature is negative it
    ends, with `singular`; what it has found by then still points downhill."""

    positive: SparseCholesky = SparseCholesky()
    rtol: float = 1e-8
    """Of the residual, in the norm of the inverse model."""
    max_steps: int = 50

    def init(self, operator: Any, options):
        return operator, self.positive.init(operator.model, options)

    def compute(self, state, vector, options):
        operator, factor = state
        precondition = lambda r: self.positive.compute(factor, r, options)[0]
        z = precondition(vector)
        size = jnp.sum(vector * z)
        tolerance = self.rtol**2 * size

        def unfinished(carry):
            *_, size, curved, steps = carry
            return (size > tolerance) & curved & (steps < self.max_steps)

        def improve(carry):
            x, r, p, size, _, steps = carry
            product = operator.mv(p)
            curvature = jnp.sum(p * product)
            # the first direction alone is downhill in any case
            length = jnp.where(curvature > 0, size / curvature, 1.0 * (steps == 0))
            x, r = x + length * p, r - length * product
            z = precondition(r)
            new_size = jnp.sum(r * z)
            return x, r, z + new_size / size * p, new_size, curvature > 0, steps + 1

        start = (jnp.zeros_like(vector), vector, z, size, jnp.array(True), 0)
        x, _, _, size, curved, _ = jax.lax.while_loop(unfinished, improve, start)
        converged = curved & (size <= tolerance)
        result = lx.RESULTS.where(converged, lx.RESULTS.successful, lx.RESULTS.singular)
        return x, result, {}


class DenseCholesky(_AbstractDirect):
    """The same of a whole matrix."""

    def init(self, operator: SparseSymmetric, options):
        del options
        return _dense(operator)

    def compute(self, state, vector, options):
        matrix, scale = state
        rhs = _flat(scale, vector)

        def solve(ridge):
            factor = jnp.linalg.cholesky(matrix + ridge * jnp.eye(len(matrix)))
            return jax.scipy.linalg.cho_solve((factor, True), rhs)

        solution = _unflat(scale, vector, _with_least_ridge(solve, rhs))
        return solution, lx.RESULTS.successful, {}


def _with_least_ridge(solve: Callable, like: Array) -> Array:
    """`solve` of the first of `RIDGES` that gives numbers."""
    ridges = jnp.array(RIDGES)

    def attempt(carry):
        _, tries = carry
        return solve(ridges[tries]), tries + 1

    def indefinite(carry):
        x, tries = carry
        return (tries < len(RIDGES)) & ~jnp.all(jnp.isfinite(x))

    return jax.lax.while_loop(indefinite, attempt, (jnp.full_like(like, jnp.nan), 0))[0]


class LeastShift(_AbstractDirect):
    """For an exact Hessian, which may be indefinite: as little of its positive definite
    model is added as makes it definite, so the solution always points downhill. Says
    `singular` where any is needed."""

    positive: BandCholesky | DenseCholesky
    shifts: tuple[float, ...] = eqx.field(static=True, default=SHIFTS)

    def init(self, operator: Any, options):
        del options
        return operator.assembled(), operator.model

    def compute(self, state, vector, options):
        exact, model = state
        shifts = jnp.array(self.shifts)

        def attempt(carry):
            _, tries = carry
            blocks = exact.blocks + shifts[tries] * model.blocks
            operator = eqx.tree_at(lambda o: o.blocks, exact, blocks)
            factor = self.positive.init(operator, options)
            return self.positive.compute(factor, vector, options)[0], tries + 1

        def indefinite(carry):
            x, tries = carry
            return (tries < len(self.shifts)) & ~jnp.all(jnp.isfinite(x))

        start = (jnp.full_like(vector, jnp.nan), 0)
        x, tries = jax.lax.while_loop(indefinite, attempt, start)
        successful, singular = lx.RESULTS.successful, lx.RESULTS.singular
        return x, lx.RESULTS.where(tries == 1, successful, singular), {}


class DirectSolvers(eqx.Module):
    """What a Newton solve needs."""

    positive: lx.AbstractLinearSolver
    """For the Gauss-Newton model."""
    indefinite: lx.AbstractLinearSolver
    """For the exact Hessian."""
    at_minimum: lx.AbstractLinearSolver
    """The same where it has to be positive definite: else not a number."""


def direct_solvers(kind: str = "auto", dim: int = 2) -> DirectSolvers:
    """`"sparse"`, `"dense"`, or `"auto"`: sparse on the CPU, dense elsewhere.
    `dim`: of the source."""
    if kind == "auto":
        kind = "sparse" if jax.default_backend() == "cpu" else "dense"
    if kind == "sparse":
        if dim == 1:
            return _shifting(BandCholesky())
        return DirectSolvers(SparseCholesky(), ModelCG(), ModelCG())
    if kind == "dense":
        return _shifting(DenseCholesky())
    raise ValueError(
        f"linear_algebra: expected 'auto', 'sparse' or 'dense', found {kind!r}."
    )


def _shifting(positive: BandCholesky | DenseCholesky) -> DirectSolvers:
    return DirectSolvers(positive, LeastShift(positive), LeastShift(positive, (0.0,)))


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


def _dense(operator: lx.AbstractLinearOperator):
    matrix = operator.as_matrix()
    scale = _inverse_root(jnp.diagonal(matrix))
    shape = operator.in_structure().shape
    return matrix * scale[:, None] * scale[None, :], scale.reshape(shape)
