"""Each datum of a fitted map: what it misses, what it would if left out, what the loss
leaves of it, how much it pulls the map to itself."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .._discretisation.jets import in_order
from .._objective.arguments import argument
from .._objective.problem import Problem, psi_jets
from .._objective.sites import at_site, sites
from .._objective.terms import weight_of
from .._programs.program import program
from .at_minimum import AtMinimum
from .minimise import projected_stage


class Diagnostics(NamedTuple):
    """Of n data: those of positive weight, on sources other than curves at most 1,000 of
    them, drawn at random, always the same."""

    data: Int[np.ndarray, " n"]
    """Their indices."""
    inputs: Float[np.ndarray, "n ..."]
    """`(n, *source.point_shape)`."""
    residuals: Float[np.ndarray, " n"]
    """Lengths, in the unit of N; of data with a precision that is 0 along some direction
    without the part along it."""
    left_out: Float[np.ndarray, " n"]
    """Likewise in the fit without the datum, to first order."""
    standardised: Float[np.ndarray, " n"]
    r"""$\sqrt{r_i^\top (1 - h_{ii})^{-1} r_i} / \sigma_i$: were the noise Gaussian with
    what was found as its $\sigma_i$, squares would be $\chi^2_n$."""
    weights: Float[np.ndarray, " n"]
    """What the loss leaves of each."""
    leverages: Float[np.ndarray, " n"]
    """The mean over the n directions: between 0 and 1, their sum times n is `edf`."""

    def worst(self, count: int = 5) -> "Diagnostics":
        """The `count` data of the largest standardised residuals, descending."""
        largest = np.argsort(-self.standardised, kind="stable")[:count]
        return Diagnostics(*(column[largest] for column in self))


def diagnostics(problem: Problem, found: AtMinimum, sigma: float) -> Diagnostics:
    """`sigma`: standard deviation of a datum of mean precision."""
    seen, index = found.leverages, found.data
    weights = np.asarray(problem.weights)
    share = weights[index] / np.mean(weights[weights > 0])
    squares = np.sum(seen.residuals * seen.left_out, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):  # of data without noise
        standardised = np.sqrt(share * np.maximum(squares, 0.0)) / sigma
    inputs = problem.source.from_ambient(np.asarray(problem.x))
    each = Diagnostics(
        data=index,
        inputs=np.asarray(inputs)[index],
        residuals=_lengths(problem, index, seen.residuals, np.sqrt(seen.squares)),
        left_out=_lengths(
            problem, index, seen.left_out, np.linalg.norm(seen.left_out, axis=1)
        ),
        standardised=_numbers(standardised),
        weights=np.asarray(seen.rho)[:, 1],
        leverages=np.asarray(seen.leverages).sum(1) / problem.target.dim,
    )
    return each if problem.owner is None else _by_datum(problem, each)


def _by_datum(problem: Problem, nodes: Diagnostics) -> Diagnostics:
    """Means over the inputs that a datum may have, as likely as they are: of inputs, and
    of squares. Leverages add."""
    assert problem.owner is not None
    owner, weights = problem.owner[nodes.data], np.asarray(problem.weights)[nodes.data]
    data, place = np.unique(owner, return_inverse=True)
    total = np.bincount(place, weights)
    mean = lambda a: np.bincount(place, weights * a) / total
    inputs = nodes.inputs.reshape(len(owner), -1)
    inputs = np.stack([mean(column) for column in inputs.T], axis=1)
    root_mean = lambda a: np.sqrt(mean(a**2))
    return Diagnostics(
        data=data,
        inputs=inputs.reshape(-1, *nodes.inputs.shape[1:]),
        residuals=root_mean(nodes.residuals),
        left_out=root_mean(nodes.left_out),
        standardised=root_mean(nodes.standardised),
        weights=mean(nodes.weights),
        leverages=np.bincount(place, nodes.leverages),
    )


def _lengths(problem: Problem, index, whitened, lengths) -> Float[np.ndarray, " n"]:
    """In the unit of N, of residuals and their lengths in those of the mean precision."""
    q = np.asarray(problem.precision.relative)[index]
    if q.ndim == 1:
        return _numbers(lengths / np.sqrt(q))
    scale = np.linalg.norm(q, axis=2)  # of each principal axis
    known = scale > 0
    each = np.where(known, whitened, 0.0) / np.where(known, scale, 1.0)
    return _numbers(np.linalg.norm(each, axis=1))


def _numbers(values: np.ndarray) -> np.ndarray:
    """A datum that alone determines the map: without it, anything."""
    return np.where(np.isnan(values), np.inf, values)


def loss_weights(problem: Problem, model: Any) -> Float[np.ndarray, " k"]:
    r"""$\rho'$ of each datum, in their order, in a `model` fitted to the problem."""
    k = len(problem.y)
    if problem.misfit.squared:
        weights = np.ones(k)
    else:
        weights = _loss_weights(argument(problem), model.lam, model.coefficients)
        weights = np.asarray(weights)[:k]
    if problem.owner is None:
        return weights
    shares = np.asarray(problem.weights)
    total = np.bincount(problem.owner, shares)
    return np.bincount(problem.owner, shares * weights) / np.where(total > 0, total, 1)


@program(most=4)
def _loss_weights(problem: Problem, lam, w):
    _, data = sites(projected_stage(problem, lam, w))
    misfit, jets = problem.misfit, problem.data_jets

    def weight(near, jet, args):
        return weight_of(misfit, misfit.square(near, jet, args[0]))

    weights = at_site(data, weight, psi_jets(problem, jets, w))
    return in_order(jets, weights[..., None], len(problem.y))[:, 0]
