"""Maps that stay on N from the start: the predecessor of the Eells solver."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jaxtyping import Array, Float
from regular_grid import Grid, cubic_weights, grid_on, interpolation, second_differences
from scipy.sparse.linalg import spsolve

from manireg._input.numbers import Numbers
from manireg._input.precision import check_x64
from manireg._source import AbstractSource
from manireg._sources.checks import check_lam
from manireg._sources.data import check_data
from manireg._sources.sources import Box, Interval
from manireg.baselines._inputs import only_for, predicted
from manireg.baselines._projected_thin_plate import projected_thin_plate
from manireg.manifolds import AbstractManifold
from manireg.manifolds._defaults.frames import tangent_frames

NODES = {1: 400, 2: 40}
LEVELS = 3  # grids, each twice as fine as the one before
RTOL = 1e-12


class HardConstraint(eqx.Module):
    """Values on a regular grid, interpolated cubically and projected."""

    source: Box | Interval
    target: AbstractManifold
    grid: Grid
    values: Float[Array, "nodes t"]
    lam: float
    loss: float
    """(Weighted) mean squared geodesic error on the data."""
    eells: float
    """S, the Eells energy by finite differences."""
    steps: int
    """Gauss-Newton steps on the finest grid."""
    converged: bool

    def __call__(self, x: Numbers) -> Float[Array, "..."]:
        """Values at `x`, `(n, *source.point_shape)` or a single point, on the target."""

        def values(flat):
            q = _interpolate(self.grid, self.values, flat)
            return self.target.project(q.reshape(-1, *self.target.point_shape))

        return predicted(self, self.source, self.target, x, values)


def hard_constraint(
    source: AbstractSource,
    target: AbstractManifold,
    x: Numbers,
    y: Numbers,
    lam: Numbers,
    *,
    weights: Numbers | None = None,
    nodes: int | None = None,
    max_steps: int = 100,
) -> HardConstraint:
    r"""Minimise the objective of `manireg.fit` over values $q_g \in N$ on a grid:

    $$\frac{\sum_i w_i d_N(y_i, \pi(\sum_g b_{ig} q_g))^2}{\sum_i w_i}
    + \lambda \sum_{g, a, b} h_g |P(q_g) (\Delta_{ab} q)_g|^2$$

    with b cubic interpolation and $\Delta_{ab}$ second differences: the constraint
    holds at every step, the discretisation is of second order. Gauss-Newton along N
    (steps in the tangent spaces, retracted by $\pi$), coarse to fine, from the
    projected thin-plate spline. Being independent of basis, quadrature and solver of
    `manireg.solve`, it checks them.

    Reconstructed from Steinke and Hein 2008, who cite it as their earlier method: F.
    Steinke, M. Hein, J. Peters, B. Schoelkopf, Manifold-valued thin-plate splines with
    applications in computer graphics, Eurographics 2008.

    **Arguments:**

    - `source`: an `Interval` or a `Box`; the method knows no other inputs.
    - `target`, `x`, `y`, `weights`, `lam`: as for `manireg.solve`.
    - `nodes`: of the grid, along the longest axis; default 400 on curves, 40 on
      surfaces, 12 above.
    - `max_steps`: Gauss-Newton steps a grid.
    """
    check_x64()
    lam = float(check_lam(lam))
    if not isinstance(source, Interval | Box):
        raise only_for("hard_constraint", "Interval, Box", source)
    nodes = NODES.get(source.dim, 12) if nodes is None else nodes
    if nodes < 8:
        raise ValueError(
            f"nodes: need at least 8 along the longest axis, found {nodes}."
        )
    flat, outputs, shares = check_data(source, target, x, y, weights)
    shares = np.asarray(shares / jnp.sum(shares))
    coarsest = max(8, nodes // 2 ** (LEVELS - 1))
    sizes = sorted({max(coarsest, nodes // 2**level) for level in range(LEVELS)})
    model = projected_thin_plate(source, target, x, y, lam, weights=weights)
    for size in sizes:
        grid = grid_on(source, size)
        q = model(jnp.asarray(grid.points).reshape(-1, *source.point_shape))
        q = np.asarray(q).reshape(-1, outputs.shape[1])
        parts = _Discrete(target, grid, flat, np.asarray(outputs), shares, lam)
        q, steps, converged = _gauss_newton(parts, q, max_steps)
        model = HardConstraint(
            source=source,
            target=target,
            grid=grid,
            values=jnp.asarray(q),
            lam=lam,
            loss=parts.loss(q),
            eells=parts.energy(q) / lam,
            steps=steps,
            converged=converged,
        )
    assert isinstance(model, HardConstraint)
    return model


@eqx.filter_jit
def _interpolate(grid: Grid, values, x) -> Float[Array, "n t"]:
    index, weights = cubic_weights(grid, x)
    return jnp.einsum("nw,nwt->nt", weights, values[index])


class _Discrete:
    """Residuals of the objective on one grid, their sparse Jacobian; on the host."""

    def __init__(self, target: AbstractManifold, grid: Grid, x, y, shares, lam):
        t = y.shape[1]
        values, differences, weights = second_differences(grid)
        self.target, self.y, self.lam = target, y, lam
        self.root = {"energy": np.sqrt(lam * weights), "data": np.sqrt(shares)}
        maps = {"v": values, "h": differences, "b": interpolation(grid, x)}
        self.maps = {
            name: sp.kron(a, sp.eye_array(t), "csr") for name, a in maps.items()
        }

    def loss(self, q) -> float:
        return float(np.sum(self.residuals(q)[1] ** 2))

    def energy(self, q) -> float:
        """lam S."""
        return float(np.sum(self.residuals(q)[0] ** 2))

    def objective(self, q) -> float:
        return self.loss(q) + self.energy(q)

    def residuals(self, q):
        v, h, b = self._local(q)
        energy = _energy(self.target, v, h) * self.root["energy"][:, None]
        data = _data(self.target, b, self.y) * self.root["data"][:, None]
        return np.asarray(energy), np.asarray(data)

    def jacobian(self, q, frames) -> sp.csr_array:
        """With respect to steps in the tangent `frames (nodes, t, n)`."""
        v, h, b = self._local(q)
        by_v, by_h = _energy_jacobian(self.target, v, h)
        by_b = _data_jacobian(self.target, b, self.y)
        root = self.root["energy"][:, None, None]
        energy = _blocks(root * by_v) @ self.maps["v"]
        energy += _blocks(root * by_h) @ self.maps["h"]
        data = _blocks(self.root["data"][:, None, None] * by_b) @ self.maps["b"]
        return sp.csr_array(sp.vstack([energy, data]) @ _blocks(frames))

    def _local(self, q):
        shape = (-1, self.y.shape[1])
        return (
            (self.maps[name] @ q.ravel()).reshape(shape) for name in ("v", "h", "b")
        )


def _gauss_newton(parts: _Discrete, q: np.ndarray, max_steps: int):
    """`(values, steps, converged)`; stops at a predicted relative decrease of 1e-12."""
    value = parts.objective(q)
    for step in range(1, max_steps + 1):
        frames = tangent_frames(parts.target, q)
        residual = np.concatenate([r.ravel() for r in parts.residuals(q)])
        jacobian = parts.jacobian(q, frames)
        gradient = jacobian.T @ residual
        normal = sp.csc_array(jacobian.T @ jacobian)
        ridge = sp.diags_array(1e-13 * normal.diagonal())
        direction = -spsolve(sp.csc_array(normal + ridge), gradient)
        decrease = -gradient @ direction
        if decrease <= RTOL * value:
            return q, step, True
        tangent = (frames @ direction.reshape(len(q), -1, 1))[:, :, 0]
        size = 1.0
        while True:
            trial = (q + size * tangent).reshape(-1, *parts.target.point_shape)
            trial = np.asarray(parts.target.project(jnp.asarray(trial))).reshape(
                q.shape
            )
            new = parts.objective(trial)
            if new <= value - 1e-4 * size * decrease:
                break
            size /= 2
            if size < 1e-8:
                return q, step, False
        q, value = trial, new
    return q, max_steps, False


def _energy_at(target: AbstractManifold, v, h):
    p = target.project(v.reshape(target.point_shape))
    return target.tangent_projection(p, h.reshape(p.shape)).ravel()


def _data_at(target: AbstractManifold, b, y):
    p = target.project(b.reshape(target.point_shape))
    return target.log(y.reshape(p.shape), p).ravel()


def _pointwise(function):
    return eqx.filter_jit(jax.vmap(function, in_axes=(None, 0, 0)))


_energy = _pointwise(_energy_at)
_data = _pointwise(_data_at)
_energy_jacobian = _pointwise(jax.jacfwd(_energy_at, argnums=(1, 2)))
_data_jacobian = _pointwise(jax.jacfwd(_data_at, argnums=1))


def _blocks(matrices) -> sp.csr_array:
    """Block-diagonal matrix of `matrices (n, a, b)`."""
    matrices = np.asarray(matrices)
    n, a, b = matrices.shape
    structure = (matrices, np.arange(n), np.arange(n + 1))
    return sp.csr_array(sp.bsr_array(structure, shape=(n * a, n * b)))
