"""A fitted map in words and numbers: noise, parameters, odd data, whether it converged."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .._input.shown import listed
from .._objective.arguments import on_host
from .._objective.problem import Problem
from .._objective.resolution import unresolved
from .._objective.robust import AbstractLoss
from .._objective.wavelengths import wavelength_of_lambda
from .at_minimum import at_minimum
from .diagnostics import Diagnostics, diagnostics, loss_weights
from .minimum import is_successful
from .spread import Spread

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
    r"""Of a fitted map; `print(model.summary())` is a table. Lengths are in the unit of the
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
    """Among others `edf`, the effective degrees of freedom, and `null`, those of the maps
    of no energy; `dof`, those of the data."""
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
        unit = _Unit(degrees)
        spread = self.spread
        rows = {
            "data": f"{self.k}, on a target of dimension {self.n}",
            "order": str(self.order),
            "lambda": f"{self.lam:.4g} (wavelength {self.wavelength:.3g})",
            "degrees of freedom": f"{spread.edf:.1f} of {spread.dof} (the smoothest maps "
            f"have {spread.null})",
            "sigma, found": unit(self.sigma),
        }
        if self.sigma_given is not None:
            rows["sigma, taken"] = unit(self.sigma_given)
        rows |= self._scatter(unit)
        rows["loss"] = self.loss
        if self.scale is not None:
            half, tenth = (int(np.sum(self.weights < w)) for w in (0.5, 0.1))
            rows["loss"] += f", scale {unit(self.scale)}"
            rows["weights left"] = f"{half} below a half, {tenth} below a tenth"
        for name, lengths in (
            ("residuals", self.residuals),
            ("left out", self.left_out),
        ):
            median, decile, largest, rms = map(unit, lengths)
            rows[name] = f"median {median}, 90 % {decile}, largest {largest}, rms {rms}"
        success = "successful" if self.successful else "not successful"
        rows["convergence"] = f"{success}, {self.steps} steps"
        if self.minima is not None and self.minima > 1:
            higher = f"{100 * self.second_minimum:.2g} %"
            rows["starts"] = (
                f"disagree: {self.minima} minima, the second {higher} higher"
            )
        rows["off the manifold"] = f"{self.off_manifold:.1e}"
        if self.unresolved:
            rows["basis"] = (
                f"{self.unresolved} inputs lie closer than centres and lambda resolve"
            )
        return rows | {f"note {i}": note for i, note in enumerate(self.notes, 1)}

    def _scatter(self, unit: "_Unit") -> dict[str, str]:
        rows = {}
        if self.phi is not None:
            rows["phi (reduced chi^2)"] = f"{self.phi:.3g}"
        if self.tau is not None:
            rows["tau (scatter added)"] = unit(self.tau)
        if self.log_densities is not None:
            factor, additive = self.log_densities
            other = f"tau {additive:.3f}" if self.tau else f"as given {additive:.3f}"
            better = "phi" if self.likelier == "factor" else other.rsplit(" ", 1)[0]
            rows["log density, left out"] = (
                f"phi {factor:.3f}, {other}: {better} likelier"
            )
        return rows

    def worst_table(self, degrees: float | None = None) -> list[list[str]]:
        """Rows of the worst five, after those of their names."""
        unit, worst = _Unit(degrees), self.worst
        lines = [
            ["index", "input", "residual", "left out", "in sigma", "weight", "lever"]
        ]
        for i, x, residual, left_out, z, weight, h in zip(*worst, strict=True):
            place = listed(np.array([float(f"{v:.5g}") for v in np.ravel(x)]))
            place = place[1:-1] if np.size(x) == 1 else place
            numbers = f"{z:.2f}", f"{weight:.2f}", f"{h:.2f}"
            lines.append([str(i), place, unit(residual), unit(left_out), *numbers])
        return lines

    def __str__(self) -> str:
        rows, table = self.rows(), self.worst_table()
        width = max(map(len, rows))
        lines = [f"{name:<{width}}  {value}" for name, value in rows.items()]
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        title = f"worst {len(table) - 1} data"
        return "\n".join([*lines, "", title, *(_aligned(row, widths) for row in table)])


class _Unit(NamedTuple):
    """How lengths are written."""

    degrees: float | None

    def __call__(self, length: float) -> str:
        if self.degrees is None:
            return f"{length:.3g}"
        return f"{length * self.degrees:.3g}°"


def _aligned(cells: list[str], widths: list[int]) -> str:
    return "  ".join(f"{c:>{w}}" for c, w in zip(cells, widths, strict=True))


def summary_of(model: Any) -> Summary:
    """**Raises** ValueError for a map without its problem."""
    problem = _problem_of(model, "summary")
    found = at_minimum(problem, model)
    spread, precision, misfit = found.spread, problem.precision, problem.misfit
    sigma = float(np.sqrt(spread.found if spread.robust is None else spread.robust))
    each = diagnostics(problem, found, sigma)
    given = None if spread.precision is None else spread.precision**-0.5
    tau = None if given is None else float(np.asarray(precision.scatter))
    phi = spread.phi if precision.phi is None and not tau else precision.phi
    heavy = np.asarray(problem.weights) > 0
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
    return loss_weights(_problem_of(model, "data_weights"), model)


def _problem_of(model: Any, name: str) -> Problem:
    if model.problem is None:
        raise ValueError(
            f"{name}: this map has left its problem behind (it was fitted under `jit` or "
            "`vmap`, or stored alone); fit it outside of them, or give "
            "`dataclasses.replace(model, problem=problem)`."
        )
    return model.problem


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
