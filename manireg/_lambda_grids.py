"""Grids of lambda, whose unit is a wavelength on the source."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._folds import GRID
from ._problem import Problem
from ._sources import sampled_dim

LONGEST = 2.7  # wavelength at the top of a short grid, in spacings of the data
RATIO = 3.4  # of neighbouring lambdas in it


def lambda_grid(problem: Problem, n: int = GRID) -> Float[Array, " n"]:
    r"""Scale-free grid, equal steps of log lambda: lambda = (l / 2 pi)^4 / vol(M) for
    wavelengths l from the spacing of the data, (vol(M)/k)^{1/m}, to twice the size of M,
    vol(M)^{1/m}.

    A perturbation of wavelength l adds to loss and penalty alike at that lambda, whatever
    the scale of the target. Below the spacing the data say nothing.
    """
    size = problem.volume ** (1 / sampled_dim(problem.source))
    low = jnp.log(lambda_of_wavelength(problem, data_spacing(problem)))
    high = jnp.log(lambda_of_wavelength(problem, 2 * size))
    return jnp.exp(jnp.linspace(low, high, n))


def data_spacing(problem: Problem):
    return (problem.volume / len(problem.y)) ** (1 / sampled_dim(problem.source))


def lambda_of_wavelength(problem: Problem, wavelength):
    return (wavelength / (2 * np.pi)) ** 4 / problem.volume


def short_grid(problem: Problem, n: int) -> Float[Array, " n"]:
    """For fits that are dear: from wavelengths of 2.7 spacings of the data down, each
    lambda 3.4 times the next."""
    longest = lambda_of_wavelength(problem, LONGEST * data_spacing(problem))
    return longest * RATIO ** -jnp.arange(n)[::-1]
