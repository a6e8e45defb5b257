"""Lambda as a wavelength: a perturbation of wavelength l adds to loss and penalty alike at
lambda = (l / 2 pi)^{2p} / V, V the volume that the data fill, p the order of the energy,
whatever the target's scale. On the host for arrays of NumPy, else in JAX."""

import math

from jaxtyping import Array, Float

from .._input.numbers import Numbers
from .._sources.checks import check_lam, check_positive
from .problem import Problem

ANCHOR = 1.5  # wavelength, in spacings of the data, under which maps follow them


def mean_spacing(problem: Problem):
    """Of the data that have a weight, in the volume that they fill."""
    k = (problem.weights > 0).sum()
    return (problem.data_volume / k) ** (1 / problem.dim)


def lambda_of_wavelength(problem: Problem, wavelength):
    power = 2 * problem.energy.order
    return (wavelength / (2 * math.pi)) ** power / problem.data_volume


def wavelength_of_lambda(problem: Problem, lam):
    power = 1 / (2 * problem.energy.order)
    return 2 * math.pi * (lam * problem.data_volume) ** power


def given_lambda(
    problem: Problem, lam: Numbers | None, wavelength: Numbers | None
) -> Float[Array, ""]:
    """The one that was given, by either name. **Raises** ValueError for none and both."""
    check_one(lam, wavelength)
    if wavelength is None:
        return check_lam(lam)
    return lambda_of_wavelength(problem, check_wavelength(wavelength))


def check_one(lam: Numbers | None, wavelength: Numbers | None) -> None:
    if lam is None and wavelength is None:
        raise ValueError("lam: missing; give it, or `wavelength`, which says the same.")
    if lam is not None and wavelength is not None:
        raise ValueError("lam, wavelength: both say how smooth the map is; give one.")


def check_wavelength(wavelength: Numbers) -> Float[Array, ""]:
    return check_positive(
        "wavelength",
        wavelength,
        "a wavelength must be positive and finite",
        "It is a length in the unit of x: waves that are shorter are smoothed away.",
    )


def anchor(problem: Problem):
    """The lambda where paths along lambda start."""
    return lambda_of_wavelength(problem, ANCHOR * mean_spacing(problem))
