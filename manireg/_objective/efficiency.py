r"""How much of the data a robust loss uses when the noise is Gaussian after all.

The mean of k residuals in n dimensions, each coordinate normal with variance 1, has the
variance 1 / k in each; the minimum of their losses has $\frac{1}{k} \frac{B}{A^2}$ with
$A = E[s w] / n$ (which is the mean derivative of the pull $w r$, by Stein's lemma) and
$B = E[s w^2] / n$, where $w = \rho'(s)$ and s is chi^2 of n degrees. Times s / n, its
density is that of n + 2 degrees, so that the efficiency is

$$\frac{A^2}{B} = \frac{E[w]^2}{E[w^2]}, \qquad s \sim \chi^2_{n+2}$$
"""

from collections.abc import Callable

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float
from scipy.optimize import root_scalar
from scipy.special import gammaln

from .._programs.program import evaluated, program

NODES, WEIGHTS = np.polynomial.legendre.leggauss(200)


def efficient_radius(
    loss: Callable[[float], eqx.Module], n: int, efficiency: float = 0.95
) -> float:
    """The c at which `loss(c)`, with a `rho` that changes its form at s = c^2, has the
    efficiency in n dimensions. There has to be one, between half and four times the usual
    length sqrt(n) of a residual."""
    excess = lambda c: efficiency_of(loss(c), c, n) - efficiency
    bracket = np.sqrt(n) / 2, 4 * np.sqrt(n) + 4
    with evaluated():  # all this is known
        return root_scalar(excess, bracket=bracket, xtol=1e-9).root


def efficiency_of(loss: eqx.Module, c: float, n: int) -> float:
    """By quadrature over the length r of residuals, inside and outside of c."""
    far = c + np.sqrt(n) + 10
    r, dr = map(np.concatenate, zip(_interval(0.0, c), _interval(c, far)))
    w = np.asarray(_weights(loss, r**2))
    density = _chi(r, n + 2) * dr
    return float((density @ w) ** 2 / (density @ w**2))


def _interval(a: float, b: float):
    half = (b - a) / 2
    return a + half * (1 + NODES), half * WEIGHTS


def _chi(r: Float[np.ndarray, " q"], m: int) -> Float[np.ndarray, " q"]:
    """Density of the length of a standard normal vector of m dimensions."""
    constant = (m / 2 - 1) * np.log(2) + gammaln(m / 2)
    return np.exp((m - 1) * np.log(r) - r**2 / 2 - constant)


@program(most=8)
def _weights(loss, s):
    return jax.vmap(jax.grad(loss.rho))(s)
