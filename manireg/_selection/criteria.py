"""What a lambda has to have a low value of: errors of data left out, generalised
cross-validation, or the restricted marginal likelihood."""

import abc
from collections.abc import Sequence
from typing import ClassVar, Literal

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.interpolate import BarycentricInterpolator, PchipInterpolator
from scipy.optimize import root_scalar

from .._solver.spread import Spread

CriterionName = Literal["error", "gcv", "reml"]
NEXT_TO = 1e-2  # log of a factor of lambda that is not worth a fit
SETTLED = 1e-7  # the same where the slope is known


class AbstractCriterion(eqx.Module):
    """Of the fits of one path, given by their left-out errors and spreads; `lams`
    ascending."""

    refinements: ClassVar[int] = 1
    """Lambdas off the grid that are worth a fit, at most."""

    @abc.abstractmethod
    def judged(
        self,
        lams: Sequence[float],
        errors: Float[np.ndarray, "k n"],
        spreads: Sequence[Spread | None],
    ) -> Float[np.ndarray, "rows n"]:
        """What has to have a low mean over its rows; infinite where there is none."""

    @abc.abstractmethod
    def better(
        self,
        lams: Sequence[float],
        judged: Float[np.ndarray, "rows n"],
        spreads: Sequence[Spread | None],
    ) -> float | None:
        """A lambda that is worth one more fit; or none."""


class LeftOutError(AbstractCriterion):
    """The largest tenth of the errors cut to the ninth decile."""

    def judged(self, lams, errors, spreads):
        return np.stack([cut_errors(e) for e in errors.T], axis=1)

    def better(self, lams, judged, spreads):
        return vertex(lams, np.mean(judged, axis=0))


class GeneralisedCrossValidation(AbstractCriterion):
    r"""$\frac{1}{k} \sum_i |r_i|^2 / (1 - \mathrm{edf} / kn)^2$ (Craven and Wahba
    1979)."""

    def judged(self, lams, errors, spreads):
        values = [_each(s, lambda s: s.rss / (1 - s.edf / s.dof) ** 2) for s in spreads]
        return np.array([values])

    def better(self, lams, judged, spreads):
        return vertex(lams, judged[0])


class RestrictedLikelihood(AbstractCriterion):
    r"""Minus twice the log of the marginal likelihood of the data, restricted to what is
    not in the null space of the energy, with $\sigma$ as given or at its best
    (mathematics: 10.3). Of the determinants in it,

    $$\frac{d}{d \log \lambda} (\log \det H - \log {\det}_+ \lambda Q)
    = d_0 - \mathrm{edf},$$

    so no determinant is taken: the integral of edf - d_0 along the path has neither the
    gauge nor the ridge nor a rank in it. The slope of the whole is known, and lambda its
    zero, where $k \lambda S = \hat\sigma^2 (\mathrm{edf} - d_0)$."""

    refinements = 4

    def judged(self, lams, errors, spreads):
        known = [i for i, s in enumerate(spreads) if s is not None]
        values = np.full(len(lams), np.inf)
        if not known:
            return values[None]
        at = np.log(np.asarray(lams)[known])
        some = [s for s in spreads if s is not None]
        used = np.array([s.edf - s.null for s in some])
        total = np.array([s.rss + s.penalty for s in some])
        area = np.zeros(len(at))
        if len(at) > 1:
            integral = PchipInterpolator(at, used).antiderivative()
            area = integral(at) - integral(at[-1])
        free, precision = some[0].dof - some[0].null, some[0].precision
        if precision is None:
            likely = free * np.log(total)
        else:
            likely = precision * total
        values[known] = likely - area
        return values[None] / free

    def better(self, lams, judged, spreads):
        """The zero of the slope, of the cubic through the four fits around it."""
        best = int(np.argmin(judged[0]))
        slopes = np.array([_each(s, lambda s: s.restricted_slope) for s in spreads])
        left = best if slopes[best] < 0 else best - 1
        if left < 0 or left + 1 >= len(lams):
            return None
        around = slice(max(left - 1, 0), left + 3)
        x = np.log(lams)
        ends, four = tuple(x[left : left + 2].tolist()), slopes[around]
        enclosed = slopes[left] < 0 <= slopes[left + 1]
        if not (enclosed and np.all(np.isfinite(four))):
            return None
        cubic = BarycentricInterpolator(x[around], four)
        zero = root_scalar(lambda at: float(cubic(at)), bracket=ends, xtol=SETTLED / 10)
        zero = float(zero.root)
        return float(np.exp(zero)) if np.min(np.abs(x - zero)) > SETTLED else None


def criterion_of(name: CriterionName) -> AbstractCriterion:
    """**Raises** ValueError for another name."""
    criteria = {
        "error": LeftOutError,
        "gcv": GeneralisedCrossValidation,
        "reml": RestrictedLikelihood,
    }
    if name not in criteria:
        raise ValueError(
            f"criterion: expected 'error', 'gcv' or 'reml', found {name!r}."
        )
    return criteria[name]()


def _each(spread: Spread | None, value) -> float:
    return np.inf if spread is None else float(np.nan_to_num(value(spread), nan=np.inf))


def cut_errors(errors: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """The largest tenth cut to the ninth decile; all infinite where one is."""
    if not np.all(np.isfinite(errors)):
        return np.full_like(errors, np.inf)
    return np.minimum(errors, np.quantile(errors, 0.9))


def vertex(lams: Sequence[float], means: Float[np.ndarray, " n"]) -> float | None:
    """Of the parabola through the lowest mean and its neighbours, in log lambda; None at
    an edge of the grid, or next to a lambda without a score."""
    best = int(np.argmin(np.nan_to_num(means, nan=np.inf)))
    if not 0 < best < len(lams) - 1:
        return None
    around = slice(best - 1, best + 2)
    x, y = np.log(np.asarray(lams)[around] / lams[best]), means[around]
    if not np.all(np.isfinite(y)):
        return None
    bend, slope, _ = np.polyfit(x, y, 2)
    step = -slope / (2 * bend) if bend > 0 else 0.0
    return float(lams[best] * np.exp(step)) if abs(step) > NEXT_TO else None
