"""Basis functions along geodesics of the source, to the order of the energy: products and
quotients of truncated Taylor series, on the host. (By autodiff they take a second to
compile.)

A series in u of m directions is an array `(J, ...)` of its partial derivatives at u = 0,
in the order of `partial_derivatives`.
"""

import functools
import itertools
from collections import Counter

import numpy as np
from jaxtyping import Float, Int

from .local_polynomials import LocalPolynomials
from .partial_derivatives import partial_derivatives

Series = Float[np.ndarray, "J ..."]


@functools.cache
def _leibniz(m: int, order: int) -> tuple[dict[tuple[int, int], int], ...]:
    """For each derivative of a product f g the terms f^(left) g^(right), and how often."""
    rows = {d: i for i, d in enumerate(partial_derivatives(m, order))}
    terms = []
    for directions in rows:
        splits = itertools.product((True, False), repeat=len(directions))
        parts = [
            (tuple(itertools.compress(directions, s)), tuple(_others(directions, s)))
            for s in splits
        ]
        terms.append(dict(Counter((rows[f], rows[g]) for f, g in parts)))
    return tuple(terms)


def _others(directions, chosen):
    return (d for d, c in zip(directions, chosen) if not c)


def basis_series(
    basis: LocalPolynomials,
    geodesics: Float[np.ndarray, "e p J s"],
    near: Int[np.ndarray, "e L"],
    order: int,
) -> Float[np.ndarray, "e p J LC"]:
    """Of the functions of the centres `near` an element (-1 is padding) along the
    geodesics through its points."""
    m = basis.dim
    centres, axes, widths, mixing = (
        np.asarray(a)[near]
        for a in (basis.centres, basis.frames, basis.widths, basis.mixing)
    )
    offset = np.repeat(geodesics[:, :, :, None], near.shape[1], axis=3)
    offset[:, :, 0] -= centres[:, None]
    scaled = np.moveaxis(offset, 2, 0) / widths[:, None, :, None]
    # coordinates in the frame of each centre, first axis last
    local = np.moveaxis(np.einsum("jepls,elsc->jeplc", scaled, axes), -1, 0)

    product = functools.partial(times, m=m, order=order)
    rest = -np.sum([product(x, x) for x in local], axis=0)
    rest[0] += 1.0
    rest *= (rest[0] > 0) & (near >= 0)[:, None]  # beyond the support
    squared = product(rest, rest)
    weight = product(product(squared, squared), squared)
    total = np.sum(weight, axis=-1, keepdims=True)
    share = product(weight, reciprocal(total, m, order))
    monomials: dict[tuple[int, ...], Series] = {}
    for powers in basis.exponents:  # each a factor more than one before it
        factor = next((i for i, power in enumerate(powers) if power), None)
        if factor is None:
            monomials[powers] = share
            continue
        lower = tuple(power - (i == factor) for i, power in enumerate(powers))
        monomials[powers] = product(monomials[lower], local[factor])
    stacked = np.stack([monomials[powers] for powers in basis.exponents], axis=-1)
    values = np.einsum("jeplb,elbc->epjlc", stacked, mixing)
    return values.reshape(*values.shape[:3], -1)


def times(f: Series, g: Series, m: int, order: int) -> Series:
    """The product."""
    out = np.zeros(np.broadcast_shapes(f.shape, g.shape))
    for row, terms in enumerate(_leibniz(m, order)):
        for (left, right), count in terms.items():
            out[row] += f[left] * g[right] if count == 1 else count * f[left] * g[right]
    return out


def reciprocal(f: Series, m: int, order: int) -> Series:
    """1 / f, from the derivatives of f / f."""
    out = np.empty_like(f)
    out[0] = 1.0 / f[0]
    for row, terms in enumerate(_leibniz(m, order)[1:], start=1):
        known = [n * f[i] * out[j] for (i, j), n in terms.items() if i > 0]
        out[row] = -out[0] * np.sum(known, axis=0)
    return out
