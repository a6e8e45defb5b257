"""The sparse Hessian of the objective.

E(w) = sum_q weight_q phi(A_q w), so its Hessian is sum_q A_q^T (weight_q D^2 phi) A_q.
`gauss_newton` replaces D^2 phi by 2 rho' R^T R, R the Jacobian of the residuals through
projector and projection: always positive semidefinite, and assembled. `exact`
differentiates twice. On surfaces it is only ever multiplied with vectors: its solver
iterates, with the factor of a Gauss-Newton matrix near by.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jaxtyping import Array, Bool, Float

from .._algebra.chunks import map_chunks
from .._algebra.sparse import SparseSymmetric, SparsityPattern, declare_symmetric
from .._discretisation.jets import jet_values
from .assembly import PointHessians, assembled
from .problem import psi_jets
from .sites import Site, Stage, at_points, sites
from .terms import weight_of

CHUNK_POINTS = 768  # differentiated at a time


class ExactHessian(lx.AbstractLinearOperator):
    """Assembled on demand only: its product sum_q A_q^T (weight_q D^2 phi) A_q v with a
    vector is as quick as a gradient."""

    families: tuple[PointHessians, ...]
    pattern: SparsityPattern
    model: SparseSymmetric | None
    """A positive definite operator near it."""

    def mv(self, vector):
        product = jnp.zeros_like(vector)
        for family in self.families:
            local, rows = family.at_points, np.array(family.rows)
            values = lambda v: jet_values(family.jets, v)[:, :, rows]
            jet, pull = jax.vjp(values, vector)
            bent = jnp.einsum("epij,epj->epi", local, jet.reshape(local.shape[:-1]))
            product += pull(bent.reshape(jet.shape))[0]
        return product

    def assembled(self) -> SparseSymmetric:
        return assembled(self.pattern, self.families)

    def as_matrix(self):
        return self.assembled().as_matrix()

    def transpose(self):
        return self

    def in_structure(self):
        local, rows = self.families[0].at_points, self.families[0].rows
        shape = (self.pattern.size, local.shape[-1] // len(rows))
        return jax.eval_shape(lambda: jnp.zeros(shape, local.dtype))

    def out_structure(self):
        return self.in_structure()


declare_symmetric(ExactHessian)


def gauss_newton(w: Float[Array, "KC t"], stage: Stage) -> SparseSymmetric:
    """The model: residuals as linear functions of w, weighed by rho'."""
    return assembled(stage.problem.pattern, point_hessians(w, stage, exact=False))


def exact(
    w: Float[Array, "KC t"], stage: Stage, model: SparseSymmetric | None = None
) -> ExactHessian:
    """May be indefinite, away from a minimum. `model`: of `gauss_newton`, at a map near
    by; iterative solvers need it."""
    families = point_hessians(w, stage, exact=True)
    if model is not None:
        # a pattern carried through a loop would be batched under vmap
        model = SparseSymmetric(model.blocks, stage.problem.pattern)
    return ExactHessian(families, stage.problem.pattern, model)


def point_hessians(
    w: Float[Array, "KC t"], stage: Stage, exact: bool | Bool[Array, ""]
) -> tuple[PointHessians, ...]:
    """Of both sites; of the model or, where that is traced, of either."""
    both = sites(stage)
    jets = [psi_jets(stage.problem, site.jets, w) for site in both]

    def by(of_element: Callable) -> list[Float[Array, "e p Jt Jt"]]:
        """At all points of both."""
        return [
            _each_element(of_element(site, stage), site, j)
            * site.weights[:, :, None, None]
            for site, j in zip(both, jets)
        ]

    if isinstance(exact, bool):
        local = by(_second_derivatives if exact else _squared_jacobians)
    else:
        kinds = _second_derivatives, _squared_jacobians
        local = jax.lax.cond(exact, *(lambda kind=kind: by(kind) for kind in kinds))
    return tuple(
        PointHessians(at, site.jets, site.places, tuple(site.rows.tolist()))
        for site, at in zip(both, local)
    )


def weighted_residuals(site: Site, stage: Stage) -> Callable:
    """Of a point all terms', whose squared Jacobian is half of the model there."""

    def of_point(near, jet, arguments):
        residuals = []
        for term, args in zip(site.terms, arguments, strict=True):
            weight = term.factor(stage.lam, stage.gamma)
            weight *= weight_of(term, term.square(near, jet, args))
            r = term.residual(near, jet, args)
            residuals.append(jnp.sqrt(weight) * r.ravel())
        return jnp.concatenate(residuals)

    return of_point


def _squared_jacobians(site: Site, stage: Stage) -> Callable:
    weighted = weighted_residuals(site, stage)

    def of_element(near, jets, arguments):
        values = lambda jets: at_points(site, weighted, near, jets, arguments)
        # a loop over the residuals: einsum makes a small product of every point's
        columns = jnp.moveaxis(_derivatives(values, jets, site.rows), 2, 0)
        squares = [column[:, None] * column for column in columns]
        return 2.0 * functools.reduce(jnp.add, squares).transpose(2, 0, 1)

    return of_element


def _second_derivatives(site: Site, stage: Stage) -> Callable:
    def density(near, jet, arguments):
        pairs = zip(site.terms, arguments, strict=True)
        return sum(
            term.factor(stage.lam, stage.gamma) * term.density(near, jet, args)
            for term, args in pairs
        )

    def of_element(near, jets, arguments):
        whole = lambda j: jnp.sum(at_points(site, density, near, j, arguments))
        gradient = lambda j: jax.grad(whole)(j)[:, site.rows]
        columns = _derivatives(gradient, jets, site.rows)
        return jnp.moveaxis(columns.reshape(*columns.shape[:2], -1), 0, 1)

    return of_element


def _each_element(f: Callable, site: Site, jets: Float[Array, "e p J t"]):
    """`f` of every element, so many at a time that what it passes through stays in the
    cache (measured: all at once takes three to four times as long)."""
    arrays = site.near, jets, site.arguments
    most = CHUNK_POINTS / jets.shape[1]
    every = jax.vmap(lambda a: f(*a))
    return map_chunks(every, arrays, most, site.jets.count)


def _derivatives(f, jets: Float[Array, "p J t"], rows) -> Float[Array, "jt p ..."]:
    """Derivative of `f` along each direction of the given rows, of all jets at once. A
    loop over directions: vmap over them too runs four to six times slower on a CPU."""
    J, t = jets.shape[1:]

    def along(direction):
        return jax.jvp(f, (jets,), (jnp.broadcast_to(direction, jets.shape),))[1]

    directions = jnp.eye(J * t).reshape(J, t, J, t)[rows]
    return jax.lax.map(along, directions.reshape(-1, J, t))
