"""Jets: value and derivatives of Psi as fixed linear functions of the coefficients.

The jet of a map at x in M is (value, E_a-derivatives, intrinsic second derivatives), the
Taylor coefficients of Psi(x + E u + II(u, u)/2) at u = 0. That curve agrees with the
exponential map of M to second order, so the second derivatives are those of the paper's
equation (6), in any codimension. Points are gathered in elements: those of one cell share
the union of their centres, so assembly is one dense product a cell.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from ._local_polynomials import LocalPolynomials, basis_values


class Jets(eqx.Module):
    """Linear maps from coefficients to jets, for Q points in e elements of p points."""

    matrices: Float[Array, "e p J U"]
    """J = 1 + m + m(m+1)/2 rows a point (or 1: values only); U basis functions an
    element, zero where an element has fewer."""
    columns: Int[Array, "e U"]
    """Index of each basis function, negative for padding."""
    index: Int[Array, "e p"]
    """Which of the Q points this is; padding repeats the first of the element."""
    mask: Float[Array, "e p"]
    """1, or 0 for padding."""


def jet_values(jets: Jets, w: Float[Array, "KC t"]) -> Float[Array, "e p J t"]:
    """Jets of the map with coefficients `w`."""
    return jnp.einsum("epju,eut->epjt", jets.matrices, w[jets.columns])


def values_at_data(jets: Jets, w: Float[Array, "KC t"], k: int) -> Float[Array, "k t"]:
    """Values of the map at the k points of `jets`, in their own order."""
    return in_order(jets, jet_values(jets, w)[:, :, 0], k)


def in_order(jets: Jets, values: Float[Array, "e p t"], k: int) -> Float[Array, "k t"]:
    """What the elements hold of k points, in the points' own order."""
    values = values * jets.mask[:, :, None]
    return jnp.zeros((k, values.shape[2])).at[jets.index].add(values)


def second_derivative_pairs(m: int) -> list[tuple[int, int]]:
    """Order of the second derivatives in a jet: (0,0), (0,1), ..., (m-1,m-1)."""
    return [(a, b) for a in range(m) for b in range(a, m)]


def jets_of(
    basis: LocalPolynomials,
    points: Float[Array, "Q s"],
    frames: Float[Array, "Q s m"],
    second_forms: Float[Array, "Q m m s"],
) -> Jets:
    """Full jets of `basis` at `points`. Runs once, on the host."""
    index, mask, near = _elements(basis, np.asarray(points), points_per_element=16)
    matrices = _jet_rows(basis, points[index], frames[index], second_forms[index], near)
    return Jets(matrices, _columns(basis, near), index, mask)


def value_jets(
    basis: LocalPolynomials, points: Float[Array, "Q s"], energy_jets: Jets
) -> Jets:
    """Values only. Shapes depend on the number of points and, as far as possible, on
    `energy_jets`, not on where the points lie: new data reuse a compiled program."""
    p = 4
    elements = min(len(points), (len(points) + (p - 1) * len(basis.centres)) // p)
    overlap = energy_jets.columns.shape[1] // basis.size
    least = (elements, p, overlap)
    index, mask, near = _elements(basis, np.asarray(points), p, least)
    matrices = _value_rows(basis, points[index], near)
    return Jets(matrices, _columns(basis, near), index, mask)


def _columns(basis: LocalPolynomials, near) -> Int[Array, "e U"]:
    functions = near[:, :, None] * basis.size + jnp.arange(basis.size)
    return functions.reshape(len(near), -1)


@eqx.filter_jit
def _value_rows(basis, points, near):
    row = lambda x, near: basis_values(basis, x, near)[None]
    return jax.vmap(jax.vmap(row, (0, None)))(points, near)


@eqx.filter_jit
def _jet_rows(basis, points, frames, second_forms, near):
    m = frames.shape[-1]
    pairs = second_derivative_pairs(m)

    def rows(x, frame, form, near):
        def along(u):
            curve = x + frame @ u + 0.5 * jnp.einsum("a,b,abs->s", u, u, form)
            return basis_values(basis, curve, near)

        zero = jnp.zeros(m)
        value, first = along(zero), jax.jacfwd(along)(zero)
        second = jax.jacfwd(jax.jacfwd(along))(zero)
        return jnp.stack(
            [value, *first.T, *(second[:, a, b] for a, b in pairs)], axis=0
        )

    one_element = jax.vmap(rows, (0, 0, 0, None))
    return jax.lax.map(lambda a: one_element(*a), (points, frames, second_forms, near))


def _elements(
    basis: LocalPolynomials,
    points: np.ndarray,
    points_per_element: int,
    least: tuple[int, int, int] = (0, 0, 0),
) -> tuple[Int[Array, "e p"], Float[Array, "e p"], Int[Array, "e L"]]:
    """Group points by their nearest centre, chunk the groups, join their centres: index,
    mask and centres of each element. `least` are sizes e, p, L to fill up to; a whole
    element of padding repeats the first, so that it is a valid place."""
    centres, widths = np.asarray(basis.centres), np.asarray(basis.widths)
    tree = KDTree(points)
    supports = [
        np.asarray(inside, dtype=int)
        for inside in tree.query_ball_point(centres, widths * (1 - 1e-12))
    ]
    reached = np.zeros(len(points), dtype=bool)
    nearest = np.zeros(len(points), dtype=int)
    best = np.full(len(points), np.inf)
    for i, inside in enumerate(supports):
        scaled = np.linalg.norm(points[inside] - centres[i], axis=1) / widths[i]
        closer = scaled < best[inside]
        best[inside[closer]], nearest[inside[closer]] = scaled[closer], i
        reached[inside] = True
    if not np.all(reached):
        raise ValueError(
            f"centres: {np.sum(~reached)} of {len(points)} points lie outside the "
            "support of every centre (no cover); use more centres or larger widths."
        )
    order = np.argsort(nearest, kind="stable")
    starts = np.flatnonzero(np.diff(nearest[order], prepend=-1))
    groups = np.split(order, starts[1:])
    chunks = [
        chunk
        for group in groups
        for chunk in np.array_split(group, -(-len(group) // points_per_element))
    ]
    element = np.zeros(len(points), dtype=int)
    for e, chunk in enumerate(chunks):
        element[chunk] = e
    centres_near: list[list[int]] = [[] for _ in chunks]
    for i, inside in enumerate(supports):
        for e in np.unique(element[inside]):
            centres_near[e].append(i)
    index, inside = _padded(chunks, [chunk[0] for chunk in chunks], least[1])
    near, _ = _padded(centres_near, [-1] * len(chunks), least[2])
    more = max(least[0] - len(chunks), 0)
    mask = np.pad(inside.astype(float), ((0, more), (0, 0)))
    index, near = (np.concatenate([a, a[:1].repeat(more, 0)]) for a in (index, near))
    return jnp.asarray(index), jnp.asarray(mask), jnp.asarray(near)


def _padded(rows, fill, least: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of equal length, each filled up with its `fill`; and what is not filling."""
    lengths = np.array([len(row) for row in rows])
    width = max(lengths.max(), least)
    inside = np.arange(width) < lengths[:, None]
    table = np.repeat(np.array(fill, dtype=np.int32)[:, None], width, axis=1)
    table[inside] = np.concatenate(rows)
    return table, inside
