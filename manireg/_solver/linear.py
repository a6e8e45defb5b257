"""The solvers a Newton solve needs: for its positive definite model, and for the exact
Hessian, which may be indefinite."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx

from .._algebra.cholesky import (
    AbstractDirect,
    BandCholesky,
    DenseCholesky,
    SparseCholesky,
    first_finite,
)

FLAT = 1e-8  # curvature, in units of the model's, that is rounding
SHIFTS = (0.0, 0.1, 1.0, 10.0)  # times the model, by `LeastShift`


class ModelCG(AbstractDirect):
    """Conjugate gradients for an operator that may be indefinite (the exact Hessian),
    preconditioned by the factor of its positive definite `model`. On surfaces a
    factorisation is dear and LU ten times dearer; a dozen products and solves are not,
    and the factor is that of an earlier Newton step. Where the curvature is negative by
    more than rounding it ends, with `singular`; what it has found by then still points
    downhill."""

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
            *_, size, _, flat, _, steps = carry
            return (size > tolerance) & ~flat & (steps < self.max_steps)

        def improve(carry):
            x, r, p, size, in_model, _, _, steps = carry
            product = operator.mv(p)
            curvature = jnp.sum(p * product)
            flat = curvature <= FLAT * in_model
            # the first direction alone is downhill in any case
            length = jnp.where(flat, 1.0 * (steps == 0), size / curvature)
            x, r = x + length * p, r - length * product
            z = precondition(r)
            new_size = jnp.sum(r * z)
            share = new_size / size
            bent = curvature < -FLAT * in_model
            in_model = new_size + share**2 * in_model  # p^T M p, of the next p
            return x, r, z + share * p, new_size, in_model, flat, bent, steps + 1

        no = jnp.array(False)
        start = (jnp.zeros_like(vector), vector, z, size, size, no, no, 0)
        x, *_, bent, _ = jax.lax.while_loop(unfinished, improve, start)
        successful, singular = lx.RESULTS.successful, lx.RESULTS.singular
        return x, lx.RESULTS.where(bent, singular, successful), {}


class LeastShift(AbstractDirect):
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

        def solve(shift):
            blocks = exact.blocks + shift * model.blocks
            operator = eqx.tree_at(lambda o: o.blocks, exact, blocks)
            factor = self.positive.init(operator, options)
            return self.positive.compute(factor, vector, options)[0]

        x, tries = first_finite(solve, self.shifts, vector)
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
