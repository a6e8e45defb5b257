"""The partial derivatives in m directions up to an order, and how they are numbered."""

import functools
import itertools
import math
from collections import Counter

import numpy as np
from jaxtyping import Float


@functools.cache
def partial_derivatives(m: int, order: int) -> tuple[tuple[int, ...], ...]:
    """Rows of a jet: (), (0), ..., (m-1), (0,0), (0,1), ..., (m-1,m-1), (0,0,0), ...:
    what is differentiated by, in ascending order."""
    return tuple(
        directions
        for degree in range(order + 1)
        for directions in itertools.combinations_with_replacement(range(m), degree)
    )


def rows_of_order(m: int, order: int) -> slice:
    """The partial derivatives of exactly this order."""
    return slice(math.comb(m + order - 1, m), math.comb(m + order, m))


def multiplicities(m: int, order: int) -> Float[np.ndarray, " R"]:
    """How often each of these derivatives is a component of the symmetric tensor of all:
    twice off the diagonal, say."""
    return np.array(
        [
            math.factorial(order)
            / math.prod(map(math.factorial, Counter(directions).values()))
            for directions in partial_derivatives(m, order)[rows_of_order(m, order)]
        ]
    )
