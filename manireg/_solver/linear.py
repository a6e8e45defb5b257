"""The solvers a Newton solve needs: for its positive definite model, and for the exact
Hessian, which may be indefinite."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
from jaxtyping import Array, Bool, Float

from .._algebra.cholesky import (
    AbstractDirect,
    AbstractPositive,
    BandCholesky,
    DenseCholesky,
    SparseCholesky,
    first_finite,
)
from .._algebra.sparse import SparseSymmetric
from .._objective.assembly import assembled
from .._objective.hessian import exact as exact_hessian, gauss_newton, point_hessians
from .._objective.problem import Problem
from .._objective.sites import Stage
from .newton import Direction

FLAT = 1e-8  # curvature, in units of the model's, that is rounding
SHIFTS = (0.0, 0.1, 1.0, 10.0)  # times the model, by `LeastShift`
# Unknowns, and share of the pairs of centres that meet: with a third CHOLMOD takes three
# times as long as a dense factor, with a twelfth (4,800 unknowns) a quarter of it.
DENSE, SPREAD = 4500, 0.15


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
        hessian, model = state

        def solve(shift):
            blocks = hessian.blocks + shift * model.blocks
            operator = eqx.tree_at(lambda o: o.blocks, hessian, blocks)
            factor = self.positive.init(operator, options)
            return self.positive.compute(factor, vector, options)[0]

        x, tries = first_finite(solve, self.shifts, vector)
        successful, singular = lx.RESULTS.successful, lx.RESULTS.singular
        return x, lx.RESULTS.where(tries == 1, successful, singular), {}


class AbstractSolvers(eqx.Module):
    """What a Newton solve needs."""

    positive: eqx.AbstractVar[AbstractPositive]
    """For positive definite operators, such as the Gauss-Newton model."""

    @property
    @abc.abstractmethod
    def at_minimum(self) -> lx.AbstractLinearSolver:
        """For the exact Hessian where it has to be positive definite: else not a
        number."""

    @abc.abstractmethod
    def direction(
        self,
        exact: Bool[Array, ""],
        w: Float[Array, "KC t"],
        stage: Stage,
        gradient: Float[Array, "KC t"],
        model: SparseSymmetric,
    ) -> Direction:
        """Newton's, by the exact Hessian or a new model; `model`: the last one."""


class Shifting(AbstractSolvers):
    """Both Hessians assembled by the same lines; the exact one shifted where it is
    indefinite."""

    positive: BandCholesky | DenseCholesky

    @property
    def at_minimum(self) -> LeastShift:
        return LeastShift(self.positive, (0.0,))

    def direction(self, exact, w, stage, gradient, model):
        pattern = stage.problem.pattern
        hessian = assembled(pattern, point_hessians(w, stage, exact))
        blocks = jnp.where(exact, model.blocks, hessian.blocks)
        solver, model = LeastShift(self.positive), SparseSymmetric(blocks, pattern)
        x, result, _ = solver.compute((hessian, model), gradient, {})
        return Direction(-x, result == lx.RESULTS.successful, model)


class Preconditioned(AbstractSolvers):
    """A factor of the model, and conjugate gradients for the exact Hessian."""

    positive: SparseCholesky

    @property
    def at_minimum(self) -> ModelCG:
        return ModelCG(self.positive)

    def direction(self, exact, w, stage, gradient, model):
        def solved(solver, operator, model):
            x, result, _ = solver.compute(solver.init(operator, {}), gradient, {})
            return Direction(-x, result == lx.RESULTS.successful, model)

        def by_model():
            operator = gauss_newton(w, stage)
            return solved(self.positive, operator, operator)

        def by_exact():
            return solved(self.at_minimum, exact_hessian(w, stage, model), model)

        return jax.lax.cond(exact, by_exact, by_model)


def direct_solvers(problem: Problem, kind: str = "auto") -> AbstractSolvers:
    """`"sparse"`, `"dense"`, or `"auto"`: dense on a GPU, and off curves where unknowns
    are few and meet many others."""
    on_curve, pattern = problem.basis.dim == 1, problem.pattern
    if kind == "auto":
        few = pattern.size * problem.y.shape[1] <= DENSE
        few &= 2 * len(pattern.rows) >= SPREAD * pattern.centres**2
        dense = (few and not on_curve) or jax.default_backend() != "cpu"
        kind = "dense" if dense else "sparse"
    if kind == "sparse":
        return (
            Shifting(BandCholesky()) if on_curve else Preconditioned(SparseCholesky())
        )
    if kind == "dense":
        return Shifting(DenseCholesky())
    raise ValueError(
        f"linear_algebra: expected 'auto', 'sparse' or 'dense', found {kind!r}."
    )
