r"""What is not known of lambda: the posterior as a mixture of those at several lambdas,
each as likely as its restricted likelihood says.

The prior of the standard deviation of the map's p-th derivative, $s \propto
\lambda^{-1/2}$, is $s^{-1/2} ds$, half way between one uniform in s (Gelman 2006) and one
uniform in log s, under which ever larger lambdas, all of them maps of no energy, would
have all of the probability. Chosen on smoothing splines of R^2."""

import math
from typing import Literal, NamedTuple, get_args

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, PRNGKeyArray
from scipy.interpolate import PchipInterpolator

from .._discretisation.local_polynomials import LocalPolynomials
from .._input.precision import as_scalar
from .._objective.problem import Problem, number_of_data
from .at_minimum import AtMinimum, lambda_error, seen_at
from .fitted import Limits, fitted
from .information import (
    AbstractInformation,
    ModelInformation,
    observed_information,
)
from .jet_covariances import JetsAt, displaced

PRIOR = 0.25  # p(log lambda) is proportional to lambda to minus this
FLAT = 0.1  # degrees of freedom more than a map of no energy: as good as none
STEP, LEAST_STEP = math.log(4), 0.3  # of log lambda
BEYOND = 8.0  # twice the log of how much less likely the last lambda is than the best
MOST = 16  # lambdas on each side
LEAST_SHARE = 1e-3
FLAT_VARIANCE = 1.0  # of log lambda, above which first order does not do
FURTHEST = (
    4.0  # at most taken to first order: of wavelengths a factor of 1.6 for order 2
)
LIMITS = Limits(1e-8, 60, certify=False)

Smoothing = Literal["auto", "known", "linear", "grid"]


class Conditional(eqx.Module):
    """The posterior, were lambda known."""

    share: float
    """Its probability."""
    information: AbstractInformation
    """H."""
    scale: float
    r"""$2 \hat\sigma^2 / k$."""
    shift: Float[np.ndarray, "KC t"] | None = None
    """Its mean less the fitted coefficients; None: they are its mean."""
    along: Float[np.ndarray, "KC t"] | None = None
    r"""What one standard deviation of $\log \lambda$ around here does to the
    coefficients."""

    def second_moment(
        self, jets: JetsAt, basis: LocalPolynomials
    ) -> Float[np.ndarray, "q Jt Jt"]:
        """Of the jets, about those of the fitted map."""
        moment = self.scale * self.information.covariances(jets.rows, jets.near)
        for dw in (self.shift, self.along):
            if dw is not None:
                moved = displaced(jets, basis, dw)
                moment += moved[:, :, None] * moved[:, None, :]
        return moment

    def draws(self, key: PRNGKeyArray, m: int) -> Float[np.ndarray, "m KC t"]:
        """What to add to the fitted coefficients."""
        found = np.sqrt(self.scale) * self.information.draws(key, m)
        if self.shift is not None:
            found = found + self.shift
        if self.along is not None:
            steps = jax.random.normal(jax.random.fold_in(key, 1), (m, 1, 1))
            found = found + np.asarray(steps) * self.along
        return found


class Mixture(NamedTuple):
    """Of conditional posteriors, the shares of which sum to one."""

    parts: tuple[Conditional, ...]

    def second_moment(
        self, jets: JetsAt, basis: LocalPolynomials
    ) -> Float[np.ndarray, "q Jt Jt"]:
        moments = [part.share * part.second_moment(jets, basis) for part in self.parts]
        return np.sum(moments, axis=0)

    def draws(self, key: PRNGKeyArray, m: int) -> Float[np.ndarray, "m KC t"]:
        """In random order."""
        key, order = jax.random.split(key)
        uniform = np.asarray(jax.random.uniform(order, (m,)))
        shares = np.cumsum([part.share for part in self.parts])
        owner = np.searchsorted(shares[:-1], uniform)
        place = np.argsort(owner, kind="stable")
        keys = jax.random.split(key, len(self.parts))
        counts = np.bincount(owner, minlength=len(self.parts))
        parts = zip(self.parts, keys, counts, strict=True)
        drawn = [part.draws(own, int(n)) for part, own, n in parts if n]
        return np.concatenate(drawn)[np.argsort(place)]


def mixture_of(problem: Problem, found: AtMinimum, smoothing: Smoothing) -> Mixture:
    """**Raises** ValueError for another name, and for a grid of latent inputs."""
    latent = problem.owner is not None
    if smoothing not in get_args(Smoothing):
        raise ValueError(
            "smoothing: expected one of "
            f"{', '.join(map(repr, get_args(Smoothing)))}; found {smoothing!r}."
        )
    if smoothing == "grid" and latent:
        raise ValueError(
            'smoothing: latent inputs have no "grid", since their weights change with '
            'lambda; take "linear".'
        )
    variance, slope = math.inf, None
    if smoothing != "known":
        variance, slope = lambda_error(problem, found)
    flat = variance > FLAT_VARIANCE and problem.source.dim == 1 and not latent
    flat &= math.isfinite(found.spread.variance)  # not of a map through all its data
    if smoothing == "grid" or smoothing == "auto" and flat:
        return _over_lambdas(problem, found, math.sqrt(variance))
    information = ModelInformation.of(found)
    if latent:
        information = observed_information(problem, found)
    along = None
    if slope is not None:
        along = math.sqrt(min(variance, FURTHEST)) * slope
    scale = 2 * found.spread.variance / number_of_data(problem)
    return Mixture((Conditional(1.0, information, scale, along=along),))


def _over_lambdas(problem: Problem, found: AtMinimum, deviation: float) -> Mixture:
    """From the fit `found` up and down in log lambda, in steps of its standard deviation
    or less, as far as there is any probability."""
    step = min(max(deviation, LEAST_STEP), STEP)
    nodes = [_where_it_bends(problem, found)]
    for _ in range(MOST):
        below = _fit_at(problem, nodes[0], math.exp(-step))
        if below is None:
            break
        nodes.insert(0, below)
        if _deviance(nodes)[0] > BEYOND:
            break
    for _ in range(MOST):
        if _is_flat(nodes[-1]):
            break
        above = _fit_at(problem, nodes[-1], math.exp(step))
        if above is None:
            break
        nodes.append(above)
        if _deviance(nodes)[-1] > BEYOND:
            break
    shares = np.exp(-0.5 * _deviance(nodes))
    if _is_flat(nodes[-1]):  # it stands for all larger ones
        shares[-1] /= 1 - math.exp(-PRIOR * step)
    shares /= np.sum(shares)
    heavy = shares >= LEAST_SHARE
    total = float(np.sum(shares[heavy]))
    w, k = np.asarray(found.w), number_of_data(problem)
    return Mixture(
        tuple(
            Conditional(
                share=float(share) / total,
                information=ModelInformation.of(node),
                scale=2 * node.spread.variance / k,
                shift=np.asarray(node.w) - w,
            )
            for share, node, taken in zip(shares, nodes, heavy, strict=True)
            if taken
        )
    )


def _where_it_bends(problem: Problem, found: AtMinimum) -> AtMinimum:
    """The next fit with more parameters than maps of no energy, which fall as lambda
    grows like its inverse."""
    for _ in range(MOST):
        if not _is_flat(found):
            break
        more = (found.spread.edf - found.spread.null) / FLAT
        below = _fit_at(problem, found, float(np.clip(more, 1e-4, 0.25)))
        if below is None:
            break
        found = below
    return found


def _fit_at(problem: Problem, near: AtMinimum, factor: float) -> AtMinimum | None:
    """None where it ends in nothing that a posterior could be made of."""
    lam = as_scalar(float(near.lam) * factor)
    minimum, _ = fitted(near.given, lam, near.w, LIMITS, near.solvers)
    if not np.all(np.isfinite(np.asarray(minimum.w))):
        return None
    node = seen_at(problem, lam, minimum.w, minimum.energies)
    return node if np.isfinite(node.spread.variance) else None


def _is_flat(node: AtMinimum) -> bool:
    return node.spread.edf - node.spread.null < FLAT


def _deviance(nodes: list[AtMinimum]) -> Float[np.ndarray, " n"]:
    """Minus twice the log of their probability densities in log lambda, 0 at the best."""
    if len(nodes) == 1:
        return np.zeros(1)
    at = np.log([float(node.lam) for node in nodes])
    slopes = [node.spread.restricted_slope + 2 * PRIOR for node in nodes]
    found = PchipInterpolator(at, slopes).antiderivative()(at)
    return found - np.min(found)
