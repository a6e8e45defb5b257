"""A regular grid on a box: finite differences and cubic interpolation as sparse linear
maps of the nodal values."""

import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
from jaxtyping import Array, Float, Int

from manireg._sources.sources import Box, Interval


class Grid(eqx.Module):
    """Equidistant nodes along each axis, the ends included."""

    lower: tuple[float, ...] = eqx.field(static=True)
    upper: tuple[float, ...] = eqx.field(static=True)
    counts: tuple[int, ...] = eqx.field(static=True)

    @property
    def steps(self) -> Float[np.ndarray, " m"]:
        return np.subtract(self.upper, self.lower) / (np.array(self.counts) - 1)

    @property
    def points(self) -> Float[np.ndarray, "nodes m"]:
        axes = [
            np.linspace(low, high, n)
            for low, high, n in zip(self.lower, self.upper, self.counts, strict=True)
        ]
        return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(axes))


def grid_on(source: Box | Interval, longest: int) -> Grid:
    """`longest` nodes along the longest axis, about the same spacing along the others;
    at least the four that cubic interpolation needs."""
    lower, upper = source.bounds
    share = (upper - lower) / np.max(upper - lower)
    counts = tuple(max(4, 1 + round(float(s) * (longest - 1))) for s in share)
    return Grid(tuple(lower.tolist()), tuple(upper.tolist()), counts)


def second_differences(grid: Grid) -> tuple[sp.csr_array, sp.csr_array, np.ndarray]:
    r"""`(values, differences, weights)`: row by row, where a second difference stands,
    what it is, and its quadrature weight, so that $\int |D^2 f|^2$ is about the sum of
    weight times squared difference. Pure derivatives stand at nodes, mixed ones (which
    count twice) at the middles of cells. Both are of second order; at the ends the
    natural boundary condition makes pure second derivatives vanish."""
    eyes, inner, second, middle, first, trapezoid = [], [], [], [], [], []
    for n, h in zip(grid.counts, grid.steps, strict=True):
        eye = sp.csr_array(sp.eye_array(n))
        eyes.append(eye)
        inner.append(eye[1:-1])
        second.append((eye[2:] - 2 * eye[1:-1] + eye[:-2]) / h**2)
        middle.append((eye[1:] + eye[:-1]) / 2)
        first.append((eye[1:] - eye[:-1]) / h)
        trapezoid.append(h * np.r_[0.5, np.ones(n - 2), 0.5])
    m = len(grid.counts)
    values, differences, weights = [], [], []
    for a in range(m):
        for b in range(a, m):
            rows, columns, shares = list(eyes), list(eyes), list(trapezoid)
            for axis in {a, b}:
                n, h = grid.counts[axis], grid.steps[axis]
                rows[axis] = inner[axis] if a == b else middle[axis]
                columns[axis] = second[axis] if a == b else first[axis]
                shares[axis] = np.full(n - 2 if a == b else n - 1, h)
            values.append(functools.reduce(sp.kron, rows))
            differences.append(functools.reduce(sp.kron, columns))
            twice = 1 if a == b else 2
            weights.append(twice * functools.reduce(np.multiply.outer, shares).ravel())
    stack = lambda blocks: sp.csr_array(sp.vstack(blocks))
    return stack(values), stack(differences), np.concatenate(weights)


def cubic_weights(
    grid: Grid, x: Float[Array, "n m"]
) -> tuple[Int[Array, "n W"], Float[Array, "n W"]]:
    """The 4^m nodes about each point and their weights in the interpolating polynomial
    that is cubic along each axis (Lagrange)."""
    index = jnp.zeros((len(x), 1), int)
    weights = jnp.ones((len(x), 1))
    for axis, count in enumerate(grid.counts):
        u = (x[:, axis] - grid.lower[axis]) / grid.steps[axis]
        first = jnp.clip(jnp.floor(u).astype(int) - 1, 0, count - 4)
        u = u - first
        along = jnp.stack(
            [
                -(u - 1) * (u - 2) * (u - 3) / 6,
                u * (u - 2) * (u - 3) / 2,
                -u * (u - 1) * (u - 3) / 2,
                u * (u - 1) * (u - 2) / 6,
            ],
            axis=1,
        )
        nodes = first[:, None] + jnp.arange(4)
        index = (index[:, :, None] * count + nodes[:, None, :]).reshape(len(x), -1)
        weights = (weights[:, :, None] * along[:, None, :]).reshape(len(x), -1)
    return index, weights


def interpolation(grid: Grid, x: Float[Array, "n m"]) -> sp.csr_array:
    """`cubic_weights` as a sparse matrix `(n, nodes)`."""
    index, weights = map(np.asarray, eqx.filter_jit(cubic_weights)(grid, x))
    rows = np.repeat(np.arange(len(index)), index.shape[1])
    shape = (len(index), int(np.prod(grid.counts)))
    return sp.csr_array((weights.ravel(), (rows, index.ravel())), shape=shape)
