"""How sure a fitted map is: the Laplace approximation around it (mathematics: 10.2,
10.4)."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PRNGKeyArray
from scipy.sparse import csr_array

from .._algebra.covariances import Elements
from .._algebra.sparse import SparseSymmetric
from .._discretisation.jets import centres_near
from .._discretisation.local_polynomials import basis_values
from .._input.numbers import Numbers
from .._objective.problem import Problem
from .._objective.terms import project_flat
from .._programs.program import program
from .._programs.sizes import ROWS, at_each, filled, power_of_four
from .._sources.checks import check_inputs
from ..manifolds._defaults.frames import tangent_frames
from .at_minimum import AtMinimum, at_minimum
from .draws import draws
from .linear import AbstractSolvers
from .minimise import gauge, stage_of
from .regions import Region, quantile_radius
from .spread import Spread

DRAWS = 1000  # maps that a band is made of
LEAST_ROWS = 16


class Posterior(eqx.Module):
    r"""Of a fitted map, $w \sim N(\hat w, (2 \hat\sigma^2 / k) H^{-1})$: likelihood
    $\exp(-d^2 / 2 \sigma^2)$, prior $\exp(-k \lambda S / 2 \sigma^2)$, H the Gauss-Newton
    Hessian of the objective. Regions around the fit hold the true map as often as they say,
    averaged over x (Wahba 1983, Nychka 1988): they are wider than what noise alone does to
    the fit, by what smoothing may have taken off.

    Made by `model.posterior()`.
    """

    model: Any
    problem: Problem
    """As programs see it."""
    solvers: AbstractSolvers
    hessian: SparseSymmetric
    spread: Spread
    scale: float
    r"""$2 \hat\sigma^2 / k$."""

    def covariance(
        self, x: Numbers
    ) -> tuple[Float[np.ndarray, "q n n"], Float[np.ndarray, "q t n"]]:
        """Of the value at each of q points `x`, in an orthonormal frame of the tangent
        space of N there: covariances and frames (in flattened ambient coordinates).

        **Raises** ValueError as calling the map does."""
        flat, _ = check_inputs(self.model.source, x)
        flat = np.asarray(flat)
        ambient, psi = self._at(flat)
        target = self.model.target
        points = at_each(_landed, target, psi)
        frames = tangent_frames(target, points)
        return at_each(_in_frame, target, psi, ambient, frames), frames

    def region(
        self,
        x: Numbers,
        level: float = 0.95,
        *,
        simultaneous: bool = False,
        new: bool | float = False,
        key: PRNGKeyArray | None = None,
    ) -> Region:
        r"""Where the map is at each of q points `x`, with probability `level`.

        - `simultaneous`: a band, that holds the whole map over all of `x` with that
          probability: its radius is the quantile of the largest deviation of 1,000 drawn
          maps (`key`, default `jax.random.key(0)`).
        - `new`: True: where a new datum of mean precision would be; a number: one with
          that standard deviation.

        **Raises** ValueError as calling the map does, for a level not between 0 and 1, and
        for a band of new data."""
        if simultaneous and new:
            raise ValueError(
                "region: `new` data are regions one by one; leave out one."
            )
        covariance, frames = self.covariance(x)
        n = covariance.shape[1]
        radius = quantile_radius(level, n)
        if simultaneous:
            radius = self._band(x, covariance, frames, level, key)
        if new:
            spread = self.spread.variance if new is True else float(new) ** 2
            covariance = covariance + spread * np.eye(n)
        centre = self.model(_batch(self.model.source, x))
        return Region(self.model.target, centre, covariance, frames, radius, level)

    def sample(self, key: PRNGKeyArray, m: int) -> list[Any]:
        """`m` maps drawn at random, each a `RegressionMap`."""
        without = eqx.tree_at(
            lambda f: f.problem, self.model, None, is_leaf=lambda a: a is None
        )
        w = np.asarray(self.model.coefficients)
        drawn = jax.device_put([w + d for d in self._drawn(key, m)])
        return [eqx.tree_at(lambda f: f.coefficients, without, d) for d in drawn]

    def sampling_covariance(
        self, x: Numbers
    ) -> tuple[Float[np.ndarray, "q n n"], Float[np.ndarray, "q t n"]]:
        r"""Of the fit over repetitions of the noise, $H^{-1} (\sum J^\top J) H^{-1}$, as
        `covariance`: what a bootstrap finds, smaller than the posterior's."""
        raise NotImplementedError

    def _drawn(self, key, m: int) -> Float[np.ndarray, "m KC t"]:
        w, lam = self.model.coefficients, self.model.lam
        stage = stage_of(self.problem, lam, gauge(self.problem), "projected", w)
        found = draws(stage, w, self.hessian, self.solvers, key, m)
        return np.sqrt(self.scale) * found

    def _band(self, x, covariance, frames, level, key) -> float:
        key = jax.random.key(0) if key is None else key
        flat = np.asarray(check_inputs(self.model.source, x)[0])
        rows, near, psi = self._values(flat)
        slopes = at_each(_slope, self.model.target, psi, frames)
        drawn = self._drawn(key, DRAWS)
        size, t = drawn.shape[1:]
        values = _as_matrix(rows, near, size) @ np.moveaxis(drawn, 0, 2).reshape(size, -1)
        values = values.reshape(len(flat), t, DRAWS)
        root = np.linalg.cholesky(covariance)
        z = np.linalg.solve(root, slopes @ values)
        largest = np.max(np.sum(z**2, axis=1), axis=0)
        return float(np.sqrt(np.quantile(largest, level)))

    def _values(self, flat):
        """Basis functions `(q, L * C)` of the centres `(q, L)` near each point, and Psi
        there."""
        basis, w = self.model.basis, self.model.coefficients
        near = centres_near(basis, flat)
        rows = at_each(_rows, basis, flat, near)
        return rows, near, at_each(_psi, (w, self.model.origin), rows, near)

    def _at(self, flat):
        """Covariances `(q, t, t)` of Psi, and Psi itself."""
        rows, near, psi = self._values(flat)
        functions = self.model.basis.size
        parts, size = [], power_of_four(min(len(flat), ROWS), least=LEAST_ROWS)
        for start in range(0, len(flat), size):
            some = slice(start, start + size)
            values = filled(rows[some], size).reshape(size, 1, -1, functions)
            own = filled(near[some], size)[:, :, None]
            columns = np.where(own < 0, -1, own * functions + np.arange(functions))
            count = np.array(len(rows[some]))
            elements = Elements(values, columns.reshape(size, -1), count)
            found = _covariances(self.hessian, elements, self.solvers)
            parts.append(np.asarray(found)[: len(rows[some]), 0])
        return self.scale * np.concatenate(parts), psi


def posterior_of(model: Any) -> Posterior:
    """**Raises** ValueError for a map without its problem."""
    if model.problem is None:
        raise ValueError(
            "posterior: this map has left its problem behind (it was fitted under `jit` or "
            "`vmap`, or stored alone); fit it outside of them, or give "
            "`dataclasses.replace(model, problem=problem)`."
        )
    found: AtMinimum = at_minimum(model.problem, model)
    k = int(np.sum(np.asarray(model.problem.weights) > 0))
    scale = 2 * found.spread.variance / k
    parts = found.given, found.solvers, found.hessian, found.spread, scale
    return Posterior(model, *parts)


@program(most=8)
def _covariances(hessian, elements, solvers):
    return solvers.positive.covariances(hessian, elements)


def _batch(source, x):
    x = np.asarray(x)
    return x[None] if x.shape == source.point_shape else x


def _rows(basis, x, near):
    return basis_values(basis, x, near)


def _psi(owner, rows, near):
    w, origin = owner
    w = w.reshape(-1, len(rows) // len(near), w.shape[1])
    return origin + jnp.einsum("lc,lct->t", rows.reshape(len(near), -1), w[near])


def _as_matrix(rows, near, size: int) -> csr_array:
    """Values of all basis functions `(q, K C)`."""
    functions = rows.shape[1] // near.shape[1]
    columns = near[:, :, None] * functions + np.arange(functions)
    point = np.broadcast_to(np.arange(len(rows))[:, None, None], columns.shape)
    there = columns >= 0
    entries = rows.reshape(columns.shape)[there], (point[there], columns[there])
    return csr_array(entries, shape=(len(rows), size))


def _landed(target, psi):
    return project_flat(target, psi)


def _slope(target, psi, frame):
    """Of the projection, in the frame of the tangent space."""
    return frame.T @ jax.jacfwd(lambda q: project_flat(target, q))(psi)


def _in_frame(target, psi, covariance, frame):
    slope = _slope(target, psi, frame)
    return slope @ covariance @ slope.T
