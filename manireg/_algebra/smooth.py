"""Scalar functions that stay smooth where the textbook formula divides zero by zero.

Every distance of the library goes through `squared_angle`, a function of the squared
chord: it has finite derivatives of all orders at coincidence, where `arccos` has none.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

_SERIES_LIMIT = 0.5  # below this squared chord the power series is exact to rounding
_MAX_ANGLE = np.pi - 0.05  # beyond it the squared angle continues linearly in q
_MAX_CHORD2 = 2.0 - 2.0 * np.cos(_MAX_ANGLE)
_NO_DIRECTION = 2e-15  # a sine that is only rounding
_TINY = 1e-140  # with a square that is not 0
RIGHT_ANGLE = 2.0  # as a squared chord


def _squared_angle_series(terms: int) -> list[float]:
    """a_1 .. a_terms of F(q) = sum a_n q^n: a_1 = 1, a_{n+1} = a_n n^2/((2n+1)(2n+2))."""
    series = [1.0]
    for n in range(1, terms):
        series.append(series[-1] * n**2 / ((2 * n + 1) * (2 * n + 2)))
    return series


_F_SERIES = _squared_angle_series(20)
_G_SERIES = [(n + 1) * a for n, a in enumerate(_F_SERIES)]
_BEND_SERIES = [n * a for n, a in enumerate(_G_SERIES)][1:]


def _horner(coefficients: list[float], q: Array) -> Array:
    total = jnp.full_like(q, coefficients[-1])
    for a in coefficients[-2::-1]:
        total = total * q + a
    return total


@jax.custom_jvp
def squared_angle(q: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""$F(q) = \theta^2$ for the squared chord $q = |x-y|^2 = 2 - 2\cos\theta$ of the
    unit sphere, $F(q) = 4 \arcsin^2(\sqrt q / 2)$.

    Analytic for q < 4. Beyond $\theta = \pi - 0.05$ it continues linearly in q, so value
    and first derivative stay finite at the cut locus (q = 4), where the true squared
    distance has a corner. Compute q from the difference x - y, never from 1 - <x, y>.
    """
    small, near, far = _near_and_far(q, _MAX_CHORD2)
    excess = jnp.where(q > _MAX_CHORD2, q - _MAX_CHORD2, 0.0)
    slope = _MAX_ANGLE / np.sin(_MAX_ANGLE)
    outer = 4.0 * jnp.arcsin(jnp.sqrt(far) / 2.0) ** 2 + slope * excess
    return jnp.where(small, near * _horner(_F_SERIES, near), outer)


# Derivatives by formula: those of twenty terms, in each Hessian of each program, took a
# sixth of the time to compile.
@squared_angle.defjvp
def _(primals, tangents):
    (q,), (dq,) = primals, tangents
    return squared_angle(q), _slope(q) * dq


@jax.custom_jvp
def _slope(q: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""$F'(q) = \theta / \sin\theta$."""
    return _angle_over_sine(q, _MAX_CHORD2)


@_slope.defjvp
def _(primals, tangents):
    (q,), (dq,) = primals, tangents
    slope = _slope(q)
    small, near, far = _near_and_far(q, _MAX_CHORD2)
    # of theta / sin theta by q, 2 sin^2 theta = 2 q (1 - q / 4)
    outer = (1.0 - slope * (1.0 - far / 2.0)) / (2.0 * far * (1.0 - far / 4.0))
    outer = jnp.where(q > _MAX_CHORD2, 0.0, outer)
    return slope, jnp.where(small, _horner(_BEND_SERIES, near), outer) * dq


def _near_and_far(q, limit: float):
    """Whether the series is to be taken, what it may be taken of, and what the closed
    form, which is that of `limit` beyond it."""
    small = q < _SERIES_LIMIT
    far = jnp.clip(jnp.where(small, 1.0, q), max=limit)
    return small, jnp.where(small, q, 0.0), far


def angle_over_sine(q: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""$G(q) = F'(q) = \theta / \sin\theta$ for the squared chord q (see
    `squared_angle`), for angles up to a right one; constant beyond."""
    return _angle_over_sine(q, RIGHT_ANGLE)


def _angle_over_sine(q, limit: float):
    small, near, far = _near_and_far(q, limit)
    angle = 2.0 * jnp.arcsin(jnp.sqrt(far) / 2.0)
    sine = jnp.sqrt(far * (1.0 - far / 4.0))
    return jnp.where(small, _horner(_G_SERIES, near), angle / sine)


def sphere_log(
    p: Float[Array, "..."], q: Float[Array, "..."], radius: Float[ArrayLike, "..."]
) -> Float[Array, "..."]:
    r"""Initial velocity at p of the great circle arc to q, on spheres of `radius`
    (which broadcasts) about 0, over the last axis. To rounding up to and at the
    antipode; from there all directions lead to p, and one of them is returned."""
    gap = q - p
    chord2 = norm_squared(gap)[..., None] / radius**2
    near = chord2 < RIGHT_ANGLE
    tangent = across(p, jnp.where(near, gap, q + p))  # the same: p has none
    sine2 = norm_squared(tangent)[..., None] / radius**2
    axis = jax.nn.one_hot(jnp.argmin(jnp.abs(p), axis=-1), p.shape[-1], dtype=p.dtype)
    antipode = sine2 <= _NO_DIRECTION**2
    direction = jnp.where(near | antipode, across(p, axis), tangent)
    direction = direction / jnp.sqrt(norm_squared(direction))[..., None]
    sine = jnp.sqrt(jnp.where(antipode, 1.0, sine2))
    cosine = jnp.sum(p * q, axis=-1, keepdims=True) / radius**2
    angle = jnp.arctan2(jnp.where(antipode, 0.0, sine), cosine)
    far = radius * angle * direction
    return jnp.where(near, angle_over_sine(chord2) * tangent, far)


def across(p: Float[Array, "..."], v: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""$v - \langle p, v \rangle p / |p|^2$: the part of v orthogonal to p."""
    along = jnp.sum(p * v, axis=-1, keepdims=True)
    return v - along * p / jnp.sum(p * p, axis=-1, keepdims=True)


def off_zero(p: Float[Array, "..."]) -> Float[Array, "..."]:
    """p, but a point of the first axis where p = 0 and all directions are as good: p
    plus what is lost in rounding elsewhere (cheaper than a case, in derivatives, too)."""
    return p + _TINY * np.eye(1, p.shape[-1])[0]


def cos_sinc(squared: Float[Array, "..."]) -> tuple[Array, Array]:
    r"""$(\cos r, \sin r / r)$ as functions of $r^2$, smooth at r = 0."""
    small = squared < 1e-2
    near = jnp.where(small, squared, 0.0)
    far = jnp.sqrt(jnp.where(small, 1.0, squared))
    cosine = _horner([1.0, -1 / 2, 1 / 24, -1 / 720, 1 / 40320, -1 / 3628800], near)
    sinc = _horner([1.0, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880, -1 / 39916800], near)
    return (
        jnp.where(small, cosine, jnp.cos(far)),
        jnp.where(small, sinc, jnp.sin(far) / far),
    )


def norm_squared(v: Float[Array, "..."], axes: int = 1) -> Float[Array, "..."]:
    """Sum of squares over the last `axes` axes."""
    return jnp.sum(v**2, axis=tuple(range(-axes, 0)))


_H_SERIES = [(-1) ** n * a for n, a in enumerate(_F_SERIES)]
_H_SLOPE_SERIES = [(-1) ** n * a for n, a in enumerate(_G_SERIES)]


def squared_hyperbolic_angle(q: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""$-F(-q) = 4\, \mathrm{arsinh}^2(\sqrt q / 2)$: $\theta^2$ for the squared chord
    $q = 2 \cosh\theta - 2$ of the unit hyperboloid."""
    small, near, far = _near_and_far(q, np.inf)
    outer = 4.0 * jnp.arcsinh(jnp.sqrt(far) / 2.0) ** 2
    return jnp.where(small, near * _horner(_H_SERIES, near), outer)


def angle_over_sinh(q: Float[Array, "..."]) -> Float[Array, "..."]:
    r"""$\theta / \sinh\theta$, its derivative."""
    small, near, far = _near_and_far(q, np.inf)
    angle = 2.0 * jnp.arcsinh(jnp.sqrt(far) / 2.0)
    outer = angle / jnp.sqrt(far * (1.0 + far / 4.0))
    return jnp.where(small, _horner(_H_SLOPE_SERIES, near), outer)


def cosh_sinhc(squared: Float[Array, "..."]) -> tuple[Array, Array]:
    r"""$(\cosh r, \sinh r / r)$ as functions of $r^2$, smooth at r = 0."""
    small = squared < 1e-2
    near = jnp.where(small, squared, 0.0)
    far = jnp.sqrt(jnp.where(small, 1.0, squared))
    cosine = _horner([1.0, 1 / 2, 1 / 24, 1 / 720, 1 / 40320, 1 / 3628800], near)
    sinc = _horner([1.0, 1 / 6, 1 / 120, 1 / 5040, 1 / 362880, 1 / 39916800], near)
    return (
        jnp.where(small, cosine, jnp.cosh(far)),
        jnp.where(small, sinc, jnp.sinh(far) / far),
    )
