"""What data and prior know of the coefficients: a matrix H of which covariances are the
inverse, seen only through what it does."""

import abc

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import csr_array

from .._algebra.covariances import Elements
from .._algebra.sparse import SparseSymmetric
from .._discretisation.jets import columns_of, in_order, slots_of
from .._objective.assembly import assembled
from .._objective.hessian import point_hessians
from .._objective.problem import Problem, number_of_data, psi_jets
from .._objective.sites import at_site, sites
from .._programs.program import program
from .._programs.sizes import ROWS, filled, power_of_four
from .at_minimum import AtMinimum
from .draws import draws
from .linear import AbstractSolvers
from .minimise import projected_stage

LEAST_ROWS = 16
CHUNK_BYTES = 100_000_000  # of right-hand sides of a dense factor


class AbstractInformation(eqx.Module):
    """H, at a minimum."""

    @abc.abstractmethod
    def covariances(
        self, rows: Float[np.ndarray, "q J LC"], near: Int[np.ndarray, "q L"]
    ) -> Float[np.ndarray, "q Jt Jt"]:
        """A H^{-1} A^T at each of q points, of J linear functions A of the coefficients of
        the centres near it (negative: padding), in t coordinates each."""

    @abc.abstractmethod
    def draws(self, key: PRNGKeyArray, m: int) -> Float[np.ndarray, "m KC t"]:
        """Of N(0, H^{-1})."""


class ModelInformation(AbstractInformation):
    """The Gauss-Newton model: sparse, whatever the numbers of data and centres."""

    problem: Problem
    """As programs see it."""
    lam: Float[Array, ""]
    w: Float[Array, "KC t"]
    hessian: SparseSymmetric
    solvers: AbstractSolvers

    @classmethod
    def of(cls, found: AtMinimum) -> "ModelInformation":
        return cls(found.given, found.lam, found.w, found.hessian, found.solvers)

    def covariances(self, rows, near):
        functions = self.hessian.pattern.functions
        size = power_of_four(min(len(rows), ROWS), least=LEAST_ROWS)
        parts = []
        for start in range(0, len(rows), size):
            some = slice(start, start + size)
            count = len(rows[some])
            values = filled(rows[some], size).reshape(
                *(size, rows.shape[1]), -1, functions
            )
            columns = columns_of(filled(near[some], size), functions)
            arrays = jax.device_put((values, columns, np.array(count)))
            found = _joint(self.hessian, Elements(*arrays), self.solvers)
            parts.append(np.asarray(found)[:count])
        whole = np.concatenate(parts)
        both = whole.shape[1] * whole.shape[2]
        return whole.reshape(len(whole), both, both)

    def draws(self, key, m):
        return draws(self.problem, self.lam, self.w, self.solvers, key, m)

    def sampling(
        self, rows: Float[np.ndarray, "q J LC"], near: Int[np.ndarray, "q L"]
    ) -> Float[np.ndarray, "q Jt Jt"]:
        """A H^{-1} G H^{-1} A^T, G the part of H that is the data's: what their noise
        alone does."""
        (unknowns, t), functions = self.w.shape, self.hessian.pattern.functions
        columns, parts = columns_of(near, functions), []
        size = max(1, CHUNK_BYTES // (8 * unknowns * t * rows.shape[1] * t))
        for start in range(0, len(rows), size):
            some = slice(start, start + size)
            right = _dense(rows[some], columns[some], unknowns, t)
            right = jax.device_put(right)
            left, moved = _by_noise(
                self.problem, self.lam, self.w, self.hessian, self.solvers, right
            )
            both = (unknowns * t, len(rows[some]), -1)
            left, moved = (np.asarray(a).reshape(both) for a in (left, moved))
            parts.append(np.einsum("nqa,nqb->qab", left, moved))
        return np.concatenate(parts)


class ObservedInformation(AbstractInformation):
    r"""Of a map with latent inputs: the model of the complete data, less what is missing,
    the covariance of their scores over the nodes of each datum (Louis 1982). Data tie
    together all centres that their inputs may be near, so it is one dense matrix: of up to
    a few thousand unknowns."""

    factor: Float[np.ndarray, "KCt KCt"]
    """Cholesky, lower."""
    functions: int = eqx.field(static=True)
    t: int = eqx.field(static=True)

    def covariances(self, rows, near):
        n, (q, J, _) = len(self.factor), rows.shape
        parts, columns = [], columns_of(near, self.functions)
        size = max(1, CHUNK_BYTES // (8 * n * J * self.t))
        for start in range(0, q, size):
            some = slice(start, start + size)
            right = _dense(rows[some], columns[some], n // self.t, self.t)
            half = solve_triangular(self.factor, right.reshape(n, -1), lower=True)
            half = half.reshape(n, -1, J * self.t)
            parts.append(np.einsum("nqa,nqb->qab", half, half))
        return np.concatenate(parts)

    def draws(self, key, m):
        n = len(self.factor)
        normal = np.asarray(jax.random.normal(key, (n, m)))
        found = solve_triangular(self.factor, normal, lower=True, trans=1)
        return found.T.reshape(m, -1, self.t)


def observed_information(problem: Problem, found: AtMinimum) -> ObservedInformation:
    r"""$H - \frac{1}{2 \sigma^2 k} \sum_i \mathrm{Cov}_i(g)$, g the gradients of what the
    nodes of datum i cost, weighed as the nodes are."""
    assert problem.owner is not None
    k, n = number_of_data(problem), len(problem.y)
    functions, t = problem.pattern.functions, problem.y.shape[1]
    gradients = np.asarray(_gradients(found.given, found.lam, found.w))[:n]
    jets = problem.data_jets
    slots = np.asarray(slots_of(jets, n))
    matrices = np.asarray(jets.matrices)[:, :, 0].reshape(-1, jets.matrices.shape[-1])
    element = slots // jets.index.shape[1]
    rows, columns = matrices[slots], np.asarray(jets.columns)[element]
    size = problem.pattern.size * t
    values = rows[:, :, None] * gradients[:, None, :]
    places = columns[:, :, None] * t + np.arange(t)
    there = np.broadcast_to(columns[:, :, None] >= 0, values.shape)
    node = np.broadcast_to(np.arange(n)[:, None, None], values.shape)
    scores = csr_array((values[there], (node[there], places[there])), shape=(n, size))
    weights = np.asarray(problem.weights)
    total = np.bincount(problem.owner, weights)
    share = weights / np.where(total > 0, total, 1)[problem.owner]
    # a datum of weight omega has omega times the logarithm of the likelihood
    scale = (total / np.mean(total[total > 0]))[problem.owner]
    scores = scores.multiply(scale[:, None]).tocsr()
    by_owner = csr_array((share, (problem.owner, np.arange(n))))
    mean = by_owner @ scores
    missing = (scores.T @ scores.multiply(share[:, None])).toarray()
    missing -= (mean.T @ mean).toarray()
    known = np.asarray(found.hessian.as_matrix())
    ridge = 1e-12 * np.diag(np.abs(np.diag(known)))
    factor = _positive(known + ridge, missing / (2 * found.spread.variance * k))
    return ObservedInformation(factor, functions, t)


def _positive(known: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """The Cholesky factor of what is left; of as much of it as is positive definite, where
    the nodes have not settled."""
    for share in (1.0, 0.99, 0.9, 0.5, 0.0):
        try:
            return cholesky(known - share * missing, lower=True)
        except np.linalg.LinAlgError:
            continue
    raise np.linalg.LinAlgError("posterior: the Hessian is not positive definite.")


def _dense(rows, columns, unknowns: int, t: int) -> Float[np.ndarray, "KC t qJt"]:
    q, J, _ = rows.shape
    right = np.zeros((unknowns + 1, q, J))  # the last one takes what is padding
    right[np.maximum(columns, -1).T, np.arange(q)] = np.moveaxis(rows, 2, 0)
    right = right[:-1, None, :, :, None] * np.eye(t)[:, None, None, :]
    return right.reshape(unknowns, t, -1)


@program(most=8)
def _joint(hessian, elements: Elements, solvers) -> Float[Array, "q J t J t"]:
    return solvers.positive.covariances(hessian, elements, joint=True)


@program(most=4)
def _by_noise(problem: Problem, lam, w, hessian, solvers, right):
    """H^{-1} right, and G times it."""
    stage = projected_stage(problem, lam, w)
    factor = solvers.positive.init(hessian, {})
    left = solvers.positive.compute(factor, right, {})[0]
    families = point_hessians(w, stage, exact=False)
    data = assembled(hessian.pattern, families[1:])
    return left, jax.vmap(data.mv, in_axes=-1, out_axes=-1)(left)


@program(most=4)
def _gradients(problem: Problem, lam, w):
    """Of what each node costs, in Psi there."""
    _, data = sites(projected_stage(problem, lam, w))
    jets, misfit = problem.data_jets, problem.misfit
    psi = psi_jets(problem, jets, w)

    def gradient(near, jet, args):
        cost = lambda value: misfit.density(near, jet._replace(value=value), args[0])
        return jax.grad(cost)(jet.value)

    return in_order(jets, at_site(data, gradient, psi), len(problem.y))
