"""Basis functions along curves of the source, to second order: products and quotients of
truncated Taylor series, on the host. (By autodiff they take a second to compile.)

A series in u of m directions is an array `(J, ...)`: value, first derivatives, second ones
in the order of `second_derivative_pairs`.
"""

import numpy as np
from jaxtyping import Float, Int

from .local_polynomials import LocalPolynomials

Series = Float[np.ndarray, "J ..."]


def second_derivative_pairs(m: int) -> list[tuple[int, int]]:
    """Order of the second derivatives in a jet: (0,0), (0,1), ..., (m-1,m-1)."""
    return [(a, b) for a in range(m) for b in range(a, m)]


def basis_series(
    basis: LocalPolynomials,
    points: Float[np.ndarray, "e p s"],
    frames: Float[np.ndarray, "e p s m"],
    second_forms: Float[np.ndarray, "e p m m s"],
    near: Int[np.ndarray, "e L"],
) -> Float[np.ndarray, "e p J LC"]:
    """Of x + E u + II(u, u) / 2 at every point x: the functions of the centres `near` its
    element; -1 is padding."""
    m = frames.shape[-1]
    pairs = second_derivative_pairs(m)
    centres, axes, widths, mixing = (
        np.asarray(a)[near]
        for a in (basis.centres, basis.frames, basis.widths, basis.mixing)
    )
    rows = [points[:, :, None] - centres[:, None]]
    rows += [frames[:, :, None, :, a] for a in range(m)]
    rows += [second_forms[:, :, None, a, b] for a, b in pairs]
    rows = [np.broadcast_to(row, rows[0].shape) for row in rows]
    scaled = np.stack(rows) / widths[:, None, :, None]
    # coordinates in the frame of each centre, first axis last
    local = np.moveaxis(np.einsum("jepls,elsc->jeplc", scaled, axes), -1, 0)

    rest = -np.sum([times(x, x) for x in local], axis=0)
    rest[0] += 1.0
    rest *= (rest[0] > 0) & (near >= 0)[:, None]  # beyond the support
    squared = times(rest, rest)
    weight = times(times(squared, squared), squared)
    share = times(weight, reciprocal(np.sum(weight, axis=-1, keepdims=True)))
    monomials: dict[tuple[int, ...], Series] = {}
    for powers in basis.exponents:  # each a factor more than one before it
        factor = next((i for i, power in enumerate(powers) if power), None)
        if factor is None:
            monomials[powers] = share
            continue
        lower = tuple(power - (i == factor) for i, power in enumerate(powers))
        monomials[powers] = times(monomials[lower], local[factor])
    stacked = np.stack([monomials[powers] for powers in basis.exponents], axis=-1)
    values = np.einsum("jeplb,elbc->epjlc", stacked, mixing)
    return values.reshape(*values.shape[:3], -1)


def times(f: Series, g: Series) -> Series:
    """The product."""
    m = _directions(len(f))
    out = f[0] * g
    out[1:] += f[1:] * g[0]
    for row, (a, b) in enumerate(second_derivative_pairs(m), start=1 + m):
        out[row] += f[1 + a] * g[1 + b] + f[1 + b] * g[1 + a]
    return out


def reciprocal(f: Series) -> Series:
    """1 / f."""
    m = _directions(len(f))
    one = 1.0 / f[0]
    out = -f * one**2
    out[0] = one
    for row, (a, b) in enumerate(second_derivative_pairs(m), start=1 + m):
        out[row] += 2 * f[1 + a] * f[1 + b] * one**3
    return out


def _directions(J: int) -> int:
    """m, of J = 1 + m + m (m + 1) / 2."""
    return round((np.sqrt(8 * J + 1) - 3) / 2)
