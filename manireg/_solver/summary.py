"""A fitted map in words and numbers: noise, parameters, odd data, whether it converged."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .._objective.arguments import on_host
from .._objective.resolution import unresolved
from .._objective.robust import AbstractLoss
from .._objective.wavelengths import wavelength_of_lambda
from .at_minimum import AtMinimum, at_minimum, problem_of
from .diagnostics import Diagnostics, diagnostics, loss_weights
from .minimum import is_successful
from .spread import Spread
from .summary_text import rows_of, text_of, worst_rows

STRAIGHT = 1.0  # parameters more than the maps of no energy have
INTERPOLATING = 0.9  # of all degrees of freedom


class Lengths(NamedTuple):
    """Of residuals, in the unit of N."""

    median: float
    decile: float
    """Nine tenths are shorter."""
    largest: float
    rms: float


class Summary(NamedTuple):
    """Of a fitted map; `print(model.summary())` is a table. Lengths are in the unit of the
    target: of `Sphere(2)` radians."""

    k: int
    """Data of positive weight."""
    n: int
    """Dimension of the target."""
    order: int
    """Of the energy."""
    lam: float
    wavelength: float
    r"""$2\pi (\lambda V)^{1/2p}$, V the volume that the data fill: shorter waves are
    smoothed away (see `lambda_grid`)."""
    spread: Spread
    """What `edf`, `dof` and `sigma` come from; its `null` are the degrees of freedom of
    the maps of no energy."""
    sigma: float
    r"""$\hat\sigma$, found: the root of `rss / (dof - edf)` (with a robust loss, of the
    variance that the posterior takes), of a datum of mean precision, per direction. NaN
    where the map has as many parameters as the data."""
    sigma_given: float | None
    """The same as `sigma` or `precision` said, with `tau` or the factor if they were
    added; None where they were not given."""
    phi: float | None
    r"""Reduced $\chi^2$ of the fit that believes them: the factor on variances."""
    tau: float | None
    r"""$\tau$ in $\sigma_i^2 + \tau^2$; 0 where it was not asked for."""
    log_densities: tuple[float, float] | None
    """Of left-out data, mean per direction, with the factor and with `tau`."""
    loss: str
    """Its name, with its constants."""
    scale: float | None
    """Of a robust loss."""
    weights: Float[np.ndarray, " k"]
    """`model.data_weights`, of the data of positive weight."""
    residuals: Lengths
    left_out: Lengths
    """In the fit without each datum, to first order."""
    each: Diagnostics
    """Residuals, leverages, weights datum by datum."""
    successful: bool
    steps: int
    minima: int | None
    """How many different ones the starts found; None: not compared."""
    second_minimum: float
    """How much higher the second is, relatively."""
    off_manifold: float
    """Largest distance of Psi to N."""
    unresolved: int
    """Distinct inputs that lie closer than centres and lambda resolve."""

    @property
    def edf(self) -> float:
        """Effective degrees of freedom that the map has used."""
        return self.spread.edf

    @property
    def dof(self) -> int:
        """Degrees of freedom of the data: k n, less those of which nothing is known."""
        return self.spread.dof

    @property
    def likelier(self) -> str | None:
        """Of left-out data: `"factor"` or `"additive"`; None without both."""
        if self.log_densities is None:
            return None
        factor, additive = self.log_densities
        return "factor" if factor > additive else "additive"

    @property
    def worst(self) -> Diagnostics:
        """Five data, those of the largest standardised residuals."""
        return self.each.worst()

    @property
    def notes(self) -> list[str]:
        """What a reader should not miss."""
        spread, notes = self.spread, []
        if not self.successful:
            notes.append("Newton did not converge: take nothing here as final")
        if spread.edf < spread.null + STRAIGHT:
            flattest = "a map of no energy"
            if spread.null == self.n:
                flattest = "constant"
            elif self.order == 2 and spread.null == 2 * self.n:
                flattest = "a geodesic"
            notes.append(f"as smooth as can be: nearly {flattest}")
        if spread.edf > INTERPOLATING * spread.dof:
            notes.append("follows every datum: hardly anything is taken for noise")
        return notes

    def rows(self, degrees: float | None = None) -> dict[str, str]:
        """Names and values, in the order of the table. `degrees`: what one unit of N is
        in degrees, to write lengths in them."""
        return rows_of(self, degrees)

    def worst_table(self, degrees: float | None = None) -> list[list[str]]:
        """Rows of the worst five, after those of their names."""
        return worst_rows(self, degrees)

    def __str__(self) -> str:
        return text_of(self.rows(), self.worst_table())


def summary_of(model: Any, found: AtMinimum | None = None) -> Summary:
    """`found`: what is seen at its minimum, where that is known.

    **Raises** ValueError for a map without its problem."""
    problem = problem_of(model)
    found = at_minimum(model) if found is None else found
    spread, precision, misfit = found.spread, problem.precision, problem.misfit
    sigma = float(np.sqrt(spread.found if spread.robust is None else spread.robust))
    each = diagnostics(problem, found, sigma)
    given = None if spread.precision is None else spread.precision**-0.5
    tau = None if given is None else float(np.asarray(precision.scatter))
    phi = spread.phi if precision.phi is None and not tau else precision.phi
    heavy = np.asarray(problem.weights) > 0
    if problem.owner is not None:
        heavy = np.bincount(problem.owner, heavy) > 0
    stats, lam = model.stats, float(model.lam)
    return Summary(
        k=int(np.sum(heavy)),
        n=problem.target.dim,
        order=problem.energy.order,
        lam=lam,
        wavelength=float(wavelength_of_lambda(on_host(problem), lam)),
        spread=spread,
        sigma=sigma,
        sigma_given=given,
        phi=phi,
        tau=tau,
        log_densities=precision.log_densities,
        loss=_named(misfit.loss),
        scale=None if misfit.squared else float(misfit.scale),
        weights=loss_weights(problem, model)[heavy],
        residuals=_lengths(each.residuals),
        left_out=_lengths(each.left_out),
        each=each,
        successful=is_successful(model.result),
        steps=int(stats["num_steps"]),
        minima=int(stats["num_minima"]) if "num_minima" in stats else None,
        second_minimum=float(stats.get("second_minimum", np.inf)),
        off_manifold=float(model.energies.off_manifold),
        unresolved=unresolved(problem, lam),
    )


def data_weights_of(model: Any) -> Float[np.ndarray, " k"]:
    """**Raises** ValueError for a map without its problem."""
    return loss_weights(problem_of(model), model)


def _lengths(lengths: Float[np.ndarray, " n"]) -> Lengths:
    # "lower" of the two around a quantile: infinity minus infinity is no number
    median, decile = np.quantile(lengths, [0.5, 0.9], method="lower")
    rms = np.sqrt(np.mean(lengths**2))
    return Lengths(*map(float, (median, decile, np.max(lengths), rms)))


def _named(loss: AbstractLoss) -> str:
    """`Huber(c=1.5)`."""
    values = {f.name: getattr(loss, f.name) for f in dataclasses.fields(loss)}
    scalars = {name: v for name, v in values.items() if np.ndim(v) == 0}
    constants = ", ".join(f"{name}={float(v):.4g}" for name, v in scalars.items())
    return type(loss).__name__ + (f"({constants})" if constants else "")
