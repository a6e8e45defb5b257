"""Grids of lambda, from the wavelengths that the data can tell apart."""

import jax
import numpy as np
from jaxtyping import Array, Float

from .._input.precision import check_x64
from .._objective.arguments import on_host
from .._objective.problem import Problem
from .._objective.wavelengths import lambda_of_wavelength, mean_spacing

GRID = 20  # values of a default grid
# Least wavelength in spacings: of orders p and two the least lambdas damp what alternates
# from datum to datum alike, by a sixteenth.
FINEST = 2.0
UNRESOLVED = 0.5  # wavelength, in spacings of the centres, that no basis tells from 0
COARSE_STEP = 8**0.25  # largest factor between the wavelengths of a coarse one


def lambda_grid(problem: Problem, n: int | None = None) -> Float[Array, " n"]:
    r"""Scale-free grid, equal steps of log lambda: lambda = (l / 2 pi)^{2p} / V, p the
    order of the energy, for wavelengths l from the spacing of the data, (V/k)^{1/m}, to
    twice the size of M, vol(M)^{1/m}. V is the volume that the data fill: vol(M), or where
    they cluster (see `centres` in `make_problem`) k times that of their median spacing.

    `n` defaults to 20, or where the data cluster to as many as take the same steps.

    A perturbation of wavelength l adds to loss and penalty alike at that lambda, whatever
    the scale of the target. Below the spacing the data say nothing.

    **Example:**

    ```python
    data = mr.datasets.polar_wander("india")  # 33 poles: ages, unit vectors
    interval, sphere = mr.Interval(0, 320), mr.Sphere(2)
    problem = mr.make_problem(interval, sphere, data.ages, data.directions)
    len(mr.lambda_grid(problem))  # 20
    ```
    """
    check_x64(problem)
    low, high = _logarithms_of_ends(on_host(problem))
    if n is None:
        even = np.log(2) + np.log(len(problem.y)) / problem.dim
        even *= 2 * problem.energy.order
        n = 1 + round((GRID - 1) * max(1.0, (high - low) / even))
    return jax.device_put(np.exp(np.linspace(low, high, n)))


def coarse_grid(problem: Problem) -> Float[Array, " lams"]:
    """The same range in steps of at most a factor of 8 (order p: 8^{p/2}), but from
    wavelengths of half a spacing of the centres: below, lambda hardly changes what the
    basis can follow."""
    here = on_host(problem)
    low, high = _logarithms_of_ends(here)
    centres = (here.data_volume / len(here.basis.centres)) ** (1 / problem.dim)
    finest = np.log(lambda_of_wavelength(here, UNRESOLVED * centres))
    low = min(max(low, finest), high)
    step = 2 * here.energy.order * np.log(COARSE_STEP)
    n = 1 + int(np.ceil((high - low) / step))
    return jax.device_put(np.exp(np.linspace(low, high, n)))


def _logarithms_of_ends(here: Problem) -> tuple[float, float]:
    """Of a grid, from the wavelength of the data's spacing to that of twice the source."""
    size = np.sum(here.energy_weights) ** (1 / here.dim)
    finest = FINEST ** (1 - 2 / here.energy.order) * mean_spacing(here)
    low = float(np.log(lambda_of_wavelength(here, finest)))
    high = float(np.log(lambda_of_wavelength(here, 2 * size)))
    return low, high
