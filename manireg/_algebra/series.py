"""Power series as lists of coefficients, of numbers or vectors, cut to the shorter one."""

import functools
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Series = Sequence[Float[Array, "..."]]


def product_of_series(f: Series, g: Series) -> list[Array]:
    """Of one of numbers and another."""
    return _cauchy(lambda a, b: a * b, f, g)


def inner_of_series(f: Series, g: Series) -> list[Array]:
    """Of two of vectors, their inner product."""
    return _cauchy(lambda a, b: jnp.sum(a * b), f, g)


def _cauchy(product: Callable, f: Series, g: Series) -> list[Array]:
    orders = range(min(len(f), len(g)))
    terms = [[product(f[i], g[k - i]) for i in range(k + 1)] for k in orders]
    return [functools.reduce(jnp.add, own) for own in terms]


def inverse_root_of_series(f: Series) -> list[Array]:
    """g = 1 / sqrt(f) of a series of numbers with f(0) > 0, from 2 f g' = -f' g."""
    g = [jax.lax.rsqrt(f[0])]
    for k in range(1, len(f)):
        terms = ((i / (2 * k) - 1) * f[i] * g[k - i] for i in range(1, k + 1))
        g.append(sum(terms) * g[0] ** 2)
    return g


def derivative_of_series(f: Series) -> list[Array]:
    return [k * f[k] for k in range(1, len(f))]
