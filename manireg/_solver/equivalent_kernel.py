"""The smoother behind a fitted map, to first order: how many data its value at a point
rests on, and how wide its window is there."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .._objective.problem import Problem, number_of_data


class EquivalentKernel(NamedTuple):
    """At each of q points of a curve's source; see `Posterior.equivalent_kernel`."""

    number: Float[np.ndarray, " q"]
    """Effective number of data, of mean precision."""
    width: Float[np.ndarray, " q"]
    """Of the window, in the unit of x; at most the length of the source."""


def equivalent_kernel(
    problem: Problem, lam: float, inverse: Float[np.ndarray, "q n n"]
) -> EquivalentKernel:
    r"""`inverse`: $A H^{-1} A^\top$ of the values, in orthonormal frames.

    The window: where data of precision $\rho$ a unit of x surround x, the map is nearly
    the minimiser of $\rho \int |y - f|^2 + \lambda k \int |f^{(p)}|^2$, a convolution with
    the kernel of transform $1 / (1 + (\omega / \omega_0)^{2p})$,
    $\omega_0^{2p} = \rho / \lambda k$, whose value at 0 is $\omega_0 / c$ with
    $c = 2p \sin(\pi / 2p)$. A running mean of width W has 1 / W, so $W = c / \omega_0$;
    and as $1 / h = \rho W$, $\rho$ drops out."""
    k, p = number_of_data(problem), problem.energy.order
    n = inverse.shape[1]
    leverage = 2 / k * np.trace(inverse, axis1=1, axis2=2) / n
    c = 2 * p * math.sin(math.pi / (2 * p))
    width = c * (c * lam * k * leverage) ** (1 / (2 * p - 1))
    whole = float(np.sum(np.asarray(problem.energy_weights)))
    return EquivalentKernel(1 / leverage, np.minimum(width, whole))
