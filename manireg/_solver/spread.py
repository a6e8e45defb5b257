"""How data scatter about a fitted map, and how many parameters the map has used up."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from .._objective.objective import Energies
from .._objective.problem import Problem, number_of_data
from .._sources.orders import null_dimension
from .leverages import Leverages


class Spread(NamedTuple):
    r"""Of a fit, in units of the mean precision, with relative weights of mean 1. With a
    robust loss squares are those that its weights leave."""

    rss: float
    r"""$\sum_i \rho(|r_i|^2)$."""
    penalty: float
    r"""$k \lambda S$."""
    edf: float
    """Effective degrees of freedom, the trace of what data do to their fitted values."""
    dof: int
    """Coordinates of all data: k n, less those of which nothing is known."""
    null: int
    """d_0: of the maps of no energy, were N flat."""
    robust: float | None
    r"""Of a robust loss the variance of a datum as the posterior needs it, $\hat\sigma^2
    E \psi^2\, E \rho' / (E \psi')^2$ with the influence $\psi$; None of squares."""
    precision: float | None
    """The mean one, absolute, in N^-2; None where only ratios are known."""

    @property
    def found(self) -> float:
        r"""$\hat\sigma^2 = \mathrm{rss} / (\mathrm{dof} - \mathrm{edf})$."""
        left = self.dof - self.edf
        return self.rss / left if left > 0 else np.nan

    @property
    def phi(self) -> float | None:
        r"""Reduced $\chi^2$: what is found over what was given; None where it was not."""
        return None if self.precision is None else self.found * self.precision

    @property
    def variance(self) -> float:
        """Of a datum of mean precision: the one given, or found; of a robust loss always
        found."""
        if self.robust is not None:
            return self.robust
        return self.found if self.precision is None else 1 / self.precision

    @property
    def restricted_slope(self) -> float:
        """Of minus twice the log of the restricted likelihood, in log lambda."""
        precision = self.precision
        if precision is None:
            precision = (self.dof - self.null) / (self.rss + self.penalty)
        return precision * self.penalty - (self.edf - self.null)


def spread_of(
    problem: Problem, lam: Float[Array, ""], energies: Energies, seen: Leverages
) -> Spread:
    """Of the fit at `lam`. `seen`: of the `scored_data`, which stand for all."""
    k, n, precision = number_of_data(problem), problem.target.dim, problem.precision
    dof = k * n - unknown_directions(problem)
    edf = float(np.sum(seen.leverages))
    if problem.owner is None:
        edf *= k / len(seen.leverages)
    rss = k * float(energies.loss)
    penalty = k * float(lam) * float(energies.energy)
    null = null_dimension(problem.source, problem.energy.order) * n
    mean = None if precision.mean is None else float(precision.mean)
    robust = None if problem.misfit.squared else _robust(problem, seen, k, dof - edf)
    return Spread(rss, penalty, edf, dof, null, robust, mean)


def unknown_directions(problem: Problem) -> int:
    """Of all data, those along which nothing is known."""
    if problem.noise is None or problem.noise.axes is None:
        return 0
    lacking = np.sum(np.asarray(problem.noise.precisions) == 0, axis=1)
    heavy = np.asarray(problem.weights) > 0
    if problem.owner is not None:
        heavy &= np.append(True, np.diff(problem.owner) != 0)  # one row a datum
    return int(np.sum(lacking[heavy]))


def _robust(problem: Problem, seen: Leverages, k: int, left: float) -> float:
    """Means over the data and the n directions at each: psi is the residual times rho',
    and of its derivative n - 1 eigenvalues are rho' and one has rho'', too."""
    _, first, second = seen.rho.T
    slope = np.mean(first + 2 * second * seen.squares / problem.target.dim)
    if slope <= 0 or left <= 0:
        return np.nan
    squares = k * np.mean(first**2 * seen.squares) / left
    return float(squares * np.mean(first) / slope**2)
