"""Jets: value and derivatives of Psi as fixed linear functions of the coefficients.

The jet of a map at x in M holds the partial derivatives of Psi(exp_x(E u)) at u = 0, E a
frame: the value, first derivatives along the frame, intrinsic second derivatives (those of
the paper's equation (6), in any codimension: exp_x(E u) = x + E u + II(u, u)/2 + ...), and
so on to the order of the energy. Points are gathered in elements: those of one cell share
the union of their centres, so assembly is one dense product a cell.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int
from scipy.spatial import KDTree

from .._programs.sizes import at_each, data_bucket, fewest_data
from .local_polynomials import COVERED, LocalPolynomials, basis_values
from .taylor import basis_series

ELEMENTS = 64  # whose values are taken at a time
AT_A_TIME = 16  # whose jets are
IN_ELEMENT = 24  # points at most, half to all of it come out; on curves a spacing's
STEP = 4  # centres; see `_padded`


class Jets(eqx.Module):
    """Linear maps from coefficients to jets, for Q points in e elements of p points."""

    matrices: Float[Array, "e p J U"]
    """J rows a point, those of `partial_derivatives` (or 1: values only); U basis
    functions an element, zero where an element has fewer."""
    columns: Int[Array, "e U"]
    """Index of each basis function, negative for padding."""
    index: Int[Array, "e p"]
    """Which of the Q points this is; padding repeats the first of the element."""
    mask: Float[Array, "e p"]
    """1, or 0 for padding."""
    count: Int[Array, ""]
    """Of the elements that hold points; the others, after them, are padding."""
    buckets: tuple[tuple[int, int, int], ...] = eqx.field(static=True)
    """Elements `start` to `stop` have at most U basis functions: `(start, stop, U)`."""


def jet_values(jets: Jets, w: Float[Array, "KC t"]) -> Float[Array, "e p J t"]:
    """Jets of the map with coefficients `w`."""
    return jnp.einsum("epju,eut->epjt", jets.matrices, w[jets.columns])


def in_order(jets: Jets, values: Float[Array, "e p t"], k: int) -> Float[Array, "k t"]:
    """What the elements hold of k points, in the points' own order."""
    values = values * jets.mask[:, :, None]
    return jnp.zeros((k, values.shape[2])).at[jets.index].add(values)


def slots_of(jets: Jets, k: int) -> Int[Array, " k"]:
    """Where each of k points is among all places of elements: `element * p + place`."""
    taken = jets.mask.ravel() > 0
    slots = jnp.where(taken, jnp.arange(len(taken)), 0)
    return jnp.zeros(k, slots.dtype).at[jets.index.ravel()].add(slots)


def bucket_centres(jets: Jets, functions: int) -> list[Int[np.ndarray, "_ _"]]:
    """The centres of the elements of each bucket, negative for padding."""
    near = np.asarray(jets.columns)[:, ::functions] // functions  # -1 // f is -1
    return [near[start:stop, : U // functions] for start, stop, U in jets.buckets]


def jets_of(
    basis: LocalPolynomials, geodesics: Float[ArrayLike, "Q J s"], order: int
) -> Jets:
    """Jets of `basis` to that order at the points of a `Domain`, of which `geodesics` are
    those of the exponential map. Runs once, on the host."""
    geodesics = np.asarray(geodesics)
    where = geodesics[:, 0]
    cells = _nearest(basis, where) if basis.dim == 1 else _bisect(where, IN_ELEMENT)
    index, mask, near = _elements(basis, where, cells)
    parts = []
    for start in range(0, len(near), AT_A_TIME):
        some = slice(start, start + AT_A_TIME)
        parts.append(basis_series(basis, geodesics[index[some]], near[some], order))
    matrices = np.concatenate(parts)
    arrays = matrices, columns_of(near, basis.size), index, mask, np.array(len(near))
    arrays = jax.device_put(arrays)
    return Jets(*arrays, buckets=_buckets(near, basis))


def value_jets(
    basis: LocalPolynomials, points: Float[ArrayLike, "Q s"], energy_jets: Jets
) -> Jets:
    """Values only. Shapes depend on the `data_bucket` of the number of points and, as far
    as possible, on `energy_jets`, not on where the points lie: new data reuse a compiled
    program."""
    where = np.asarray(points)
    most = data_bucket(len(where))
    # points in an element: spread evenly, and as few as they may be in this bucket, they
    # reach no farther than those of the energy
    largest = max(1, fewest_data(most) // (3 * len(energy_jets.columns)))
    cells = _bisect(where, largest)
    overlap = energy_jets.columns.shape[1] // basis.size
    index, mask, near = _elements(basis, where, cells, overlap)
    matrices = at_each(_value_rows, basis, where[index], near, most=ELEMENTS)
    columns = columns_of(near, basis.size)
    e, U = max(len(cells), _cells(most, largest)), columns.shape[1]
    index, mask = _grown(index, 0, e, largest), _grown(mask, 0.0, e, largest)
    matrices = _grown(matrices, 0.0, e, largest)
    arrays = matrices, _grown(columns, -1, e), index, mask, np.array(len(near))
    return Jets(*jax.device_put(arrays), buckets=((0, e, U),))


def centres_near(
    basis: LocalPolynomials, points: Float[np.ndarray, "n s"]
) -> Int[np.ndarray, "n L"]:
    """The centres whose support holds each point; -1 is padding. Host."""
    supported, centre = _supports(basis, points)
    order = np.argsort(supported, kind="stable")
    near = np.split(
        centre[order], np.cumsum(np.bincount(supported, minlength=len(points)))
    )
    return _padded(near[:-1], [-1] * len(points), least=2 * STEP)[0]


def _supports(basis: LocalPolynomials, points: np.ndarray):
    """Indices of points and centres, for every point in the support of a centre."""
    radii = np.asarray(basis.widths) * (1 - 1e-12)
    inside = KDTree(points).query_ball_point(np.asarray(basis.centres), radii)
    supported = np.concatenate([np.asarray(own, dtype=int) for own in inside])
    return supported, np.repeat(np.arange(len(radii)), [len(own) for own in inside])


def _buckets(near, basis: LocalPolynomials) -> tuple[tuple[int, int, int], ...]:
    e = len(near)
    edges = np.linspace(0, e, 2 if e < 256 else 5).astype(int)
    return tuple(
        (int(start), int(stop), int(np.sum(near[stop - 1] >= 0)) * basis.size)
        for start, stop in zip(edges[:-1], edges[1:])
    )


def columns_of(near: Int[np.ndarray, "e L"], size: int) -> Int[np.ndarray, "e U"]:
    """Which unknowns the functions of these centres are, `size` of each; negative for
    padding. Host."""
    functions = near[:, :, None] * size + np.arange(size)
    return functions.reshape(len(near), -1)


def _value_rows(basis, points, near):
    return jax.vmap(lambda x: basis_values(basis, x, near)[None])(points)


def _elements(
    basis: LocalPolynomials,
    points: np.ndarray,
    cells: list[np.ndarray],
    overlap: int = 0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cells of neighbouring points, and the centres that reach each: index, mask and
    centres (at least `overlap` places for them), elements with few centres first."""
    element = np.zeros(len(points), dtype=int)
    for e, cell in enumerate(cells):
        element[cell] = e
    supported, centre = _supports(basis, points)
    offset = points[supported] - np.asarray(basis.centres)[centre]
    q = np.sum(offset**2, axis=1) / np.asarray(basis.widths)[centre] ** 2
    covers = np.bincount(supported, (1 - q) ** 6, minlength=len(points))
    uncovered = np.sum(covers <= COVERED)
    if uncovered:
        raise ValueError(
            f"centres: {uncovered} of {len(points)} points lie outside (or at the rim of) "
            "the support of every centre (no cover); use more centres or larger widths."
        )
    K = len(basis.centres)
    reaching, centre = np.divmod(np.unique(element[supported] * K + centre), K)
    near = np.split(centre, np.searchsorted(reaching, np.arange(1, len(cells))))
    order = sorted(range(len(cells)), key=lambda e: len(near[e]))
    cells, near = [cells[e] for e in order], [near[e] for e in order]
    index, filled = _padded(cells, [cell[0] for cell in cells])
    centres, _ = _padded(near, [-1] * len(cells), overlap)
    return index, filled.astype(float), centres


def _nearest(basis: LocalPolynomials, points: np.ndarray) -> list[np.ndarray]:
    """The points next to each centre: on a curve of equal spacings all of them have the
    same centres near."""
    centre = np.asarray(KDTree(np.asarray(basis.centres)).query(points)[1])
    order = np.argsort(centre, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(centre[order])) + 1)


def _bisect(points: np.ndarray, largest: int) -> list[np.ndarray]:
    """Halves of halves across the widest direction, until none holds more than `largest`
    points: how many cells there are depends on the number of points only."""

    def halves(index):
        if len(index) <= largest:
            return [index]
        axis = np.argmax(np.ptp(points[index], axis=0))
        order = index[np.argsort(points[index, axis], kind="stable")]
        half = len(index) // 2
        return [*halves(order[:half]), *halves(order[half:])]

    return halves(np.arange(len(points)))


def _cells(n: int, largest: int) -> int:
    """How many cells there are of n points."""
    return 1 if n <= largest else _cells(n // 2, largest) + _cells(n - n // 2, largest)


def _grown(array: np.ndarray, fill: float, *sizes: int) -> np.ndarray:
    """The first axes at least of these sizes."""
    more = [(0, max(0, size - n)) for size, n in zip(sizes, array.shape)]
    more += [(0, 0)] * (array.ndim - len(more))
    return np.pad(array, more, constant_values=fill)


def _padded(rows, fill, least: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rows of equal length, each filled up with its `fill`; and what is not filling.
    Beyond `least` lengths are multiples of `STEP`: few shapes, few compilations."""
    lengths = np.array([len(row) for row in rows])
    width = int(lengths.max(initial=1))
    if least:
        width = least if width <= least else _stepped(width)
    inside = np.arange(width) < lengths[:, None]
    table = np.repeat(np.array(fill, dtype=np.int32)[:, None], width, axis=1)
    table[inside] = np.concatenate(rows)
    return table, inside


def _stepped(width: int) -> int:
    """The next multiple of `STEP`."""
    return -(-width // STEP) * STEP
