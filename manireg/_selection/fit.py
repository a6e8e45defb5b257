"""The one-call path."""

import dataclasses
from collections.abc import Callable
from typing import Any, Literal

from .._input.numbers import Numbers
from .._objective.problem import Problem, make_problem
from .._objective.robust import AbstractLoss, Squared, check_loss
from .._solver.geodesic_loss import solve_geodesic
from .._solver.model import RegressionMap
from .._solver.solve import checked, solve
from .._source import AbstractSource
from .._sources.checks import check_points
from .._sources.input_errors import check_input_errors
from ..manifolds import AbstractManifold
from .choice import CrossValidation
from .criteria import CriterionName, criterion_of
from .cross_validate import cross_validate
from .effective_variance import with_effective_variance
from .latent_inputs import with_latent_inputs
from .leave_one_out import along_path
from .noise import Scatter, blunted, check_scatter, with_estimated_noise
from .one_fit import STEPS_TO_THE_END, OneFit
from .orders import Order, over_orders


def fit(
    source: AbstractSource,
    target: AbstractManifold,
    x: Numbers,
    y: Numbers,
    lam: Numbers | None = None,
    *,
    weights: Numbers | None = None,
    sigma: Numbers | None = None,
    precision: Numbers | None = None,
    frames: Numbers | None = None,
    scatter: Scatter = "additive",
    x_sigma: Numbers | None = None,
    x_min: Numbers | None = None,
    x_max: Numbers | None = None,
    x_error: Literal["latent", "effective"] = "latent",
    loss: AbstractLoss | str = "squared",
    centres: int | None = None,
    degree: int | None = None,
    width: float | None = None,
    graded: bool = False,
    tension: float = 0.0,
    order: Order = 2,
    distance: Literal["chord", "geodesic"] = "chord",
    criterion: CriterionName = "error",
    folds: int | None = None,
    **options,
) -> RegressionMap:
    r"""Learn a smooth map `source -> target` from pairs (x_i, y_i):

    $$\min_\Psi \; \frac{\sum_i w_i \rho(q_i d_N(y_i, \Psi(x_i))^2)}{\sum_i w_i}
    + \lambda \int_M |\nabla^{p-1} d\Psi|^2$$

    with relative precisions $q_i$ of mean 1 and the identity for $\rho$, unless they are
    given.

    **Arguments:** `source`, `target`, `x`, `y`, `weights`, `sigma`, `precision`, `frames`,
    `loss`, `centres`, `degree`, `width`, `graded`, `tension` as in `make_problem`; `order`
    p as there (default 2, the Eells energy), or without `lam` several, `(2, 3)` or
    `"auto"`, to choose from; `lam` lambda, or None to choose it; other options go to
    `solve` (with `lam`), `leave_one_out` or `cross_validate` (without).

    - `scatter`: what is done where data scatter more than `sigma` or `precision` say.
      `"additive"` (default): $\sigma_i^2 + \tau^2$, with $\tau$ by restricted likelihood
      (0 where they do not); `"factor"`: all variances times $\varphi$, the reduced
      $\chi^2$; `"none"`: what was given is believed. `model.summary()` tells both, and
      under which of them left-out data are likelier.
    - `loss`: a robust one whose data have no `sigma` is given its scale from them:
      squared first, then with the scale of the residuals (see
      `manireg._selection.noise`), each fit started from the one before, until that stays
      to 1 %. `model.data_weights` are the weights it leaves.
    - `criterion`: what lambda (and the order) is chosen by: `"error"` of data left out
      (default), `"gcv"` or `"reml"`, as in `leave_one_out`.
    - `folds`: choose lambda by `cross_validate` with so many folds; default by
      `leave_one_out`, of which one fit a lambda is enough.
    - `distance`: on a `PointCloud`, d_N is the chord (default: fast, right to third order)
      or the length of the shortest curve (`"geodesic"`, a few solves more, for data far
      from the map; `lam` has to be given). Other targets have d_N as it is.

    **Returns:** a `RegressionMap`: call it on new points; `.posterior()` says how sure it
    is, `.summary()` how it fits; `.energies`, `.lam`, `.result`, `.stats`.

    **Raises** ValueError as `make_problem` does and for options that exclude each other,
    RuntimeError where Newton does not converge, or a loss rejects so many data that
    nothing is determined. **Warns** where the noise does not settle.

    Source: F. Steinke, M. Hein, Non-parametric Regression Between Manifolds, NIPS 2008.
    """
    data: dict[str, Any] = {
        "weights": weights,
        "sigma": sigma,
        "precision": precision,
        "frames": frames,
        "loss": loss,
        "centres": centres,
        "degree": degree,
        "width": width,
        "graded": graded,
        "tension": tension,
        "order": order,
    }
    choice = {"distance": distance, "criterion": criterion, "folds": folds}
    options |= {"x_sigma": x_sigma, "x_min": x_min, "x_max": x_max, "x_error": x_error}
    found = chosen_fit(source, target, x, y, lam, data, scatter, **choice, **options)
    return found[0]


def chosen_fit(
    source: AbstractSource,
    target: AbstractManifold,
    x: Numbers,
    y: Numbers,
    lam: Numbers | None,
    data: dict[str, Any],
    scatter: Scatter = "additive",
    *,
    x_sigma: Numbers | None = None,
    x_min: Numbers | None = None,
    x_max: Numbers | None = None,
    x_error: Literal["latent", "effective"] = "latent",
    distance: Literal["chord", "geodesic"] = "chord",
    criterion: CriterionName = "error",
    folds: int | None = None,
    **options,
) -> tuple[RegressionMap, CrossValidation | None]:
    """What `fit` does, with the last choice of lambda before errors in x were looked at;
    None where it was given. `data`: arguments of `make_problem`, and the order or
    orders."""
    data = {"order": 2, "loss": "squared"} | data
    _check(lam, data["order"], distance, folds, data["loss"], criterion)
    check_scatter(scatter)
    inexact = _input_errors(source, x, x_sigma, x_min, x_max, x_error)
    problem, choices = (source, target, x, y), []
    progress = options.get("progress", True)
    if lam is not None:
        if inexact is not None:  # one fit has none to show, those of latent inputs have
            options.pop("progress", None)
        model, again = _given(*problem, lam, distance, data, options)
    elif folds is not None:
        model, again = _by_folds(*problem, folds, data, options, choices)
    else:
        model, again = _along_path(*problem, criterion, data, options, choices)
    model = with_estimated_noise(model, again, scatter)
    if inexact is not None and x_error == "effective":
        model = with_effective_variance(model, inexact, again, scatter)
    elif inexact is not None:
        model = with_latent_inputs(model, inexact, lam is None, scatter, progress)
    if not choices:
        return model, None
    return model, dataclasses.replace(choices[-1], others=choices[0].others)


Again = Callable[[Problem, RegressionMap], RegressionMap]
CALLS = 7  # from a choice along the path to the user's line


def _given(
    source, target, x, y, lam, distance, data, options
) -> tuple[RegressionMap, Again]:
    """The fit at a lambda, and how to repeat it near a map."""
    minimise = solve_geodesic if distance == "geodesic" else solve
    model = minimise(
        blunted(make_problem(source, target, x, y, **data)), lam, **options
    )
    options = {**options, "starts": ()}

    def again(problem, model):
        return minimise(problem, lam, **options, warm=model.coefficients)

    return model, again


def _by_folds(
    source, target, x, y, folds, data, options, choices: list[CrossValidation]
) -> tuple[RegressionMap, Again]:
    """The same with a choice of lambda, which goes to `choices`, as do those of repeated
    fits."""
    options = {**options, "folds": folds}
    choices.append(cross_validate(source, target, x, y, **data, **options))
    options["progress"] = False

    def again(problem, model):
        choices.append(cross_validate(problem, **options))
        return choices[-1].model

    return choices[0].model, again


def _along_path(
    source, target, x, y, criterion, data, options, choices: list[CrossValidation]
) -> tuple[RegressionMap, Again]:
    judge, options = criterion_of(criterion), dict(options)
    lams = options.pop("lams", None)

    def chosen(
        problem: Problem,
        lams: Numbers | None = None,
        warm: RegressionMap | None = None,
        *,
        linear_algebra: str = "auto",
        max_steps: int = 40,
        progress: bool = True,
    ) -> CrossValidation:
        score = OneFit(problem, judge, linear_algebra, max_steps, warm)
        return along_path(score, lams, progress, above=CALLS)

    def again(problem, model):
        parts = {**options, "progress": False}
        choices.append(chosen(problem, lams, model, **parts))
        return checked(choices[-1].model, STEPS_TO_THE_END)

    first = lambda problem, lams: chosen(blunted(problem), lams, **options)
    choices.append(over_orders(first, source, target, x, y, lams, **data))
    return checked(choices[0].model, STEPS_TO_THE_END), again


def _input_errors(source, x, x_sigma, x_min, x_max, x_error: str):
    if x_error not in ("latent", "effective"):
        raise ValueError(
            f"x_error: expected 'latent' or 'effective', found {x_error!r}."
        )
    if x_sigma is None and x_min is None and x_max is None:
        return None
    return check_input_errors(
        source, check_points("x", source, x), x_sigma, x_min, x_max
    )


def _check(
    lam, order: Order, distance: str, folds: int | None, loss, criterion: str
) -> None:
    if distance not in ("chord", "geodesic") or (
        distance == "geodesic" and lam is None
    ):
        raise ValueError(
            "distance: expected 'chord' or, with a given `lam`, 'geodesic'; found "
            f"{distance!r}."
        )
    if folds is not None and lam is not None:
        raise ValueError("folds: there is nothing to choose where `lam` is given.")
    if folds is not None and not isinstance(check_loss(loss), Squared):
        raise ValueError(
            "folds: each would have robust fits to start anew; leave `folds` out, to "
            "choose lambda by one fit of all data."
        )
    if folds is not None and criterion != "error":
        raise ValueError(
            f"folds: they have an error, and {criterion!r} is of one fit of all data; "
            "leave out one of them."
        )
    if lam is not None and not isinstance(order, int):
        raise ValueError(
            f"order: give one where `lam` is given, found {order!r}; lambda has a unit of "
            "its own for each."
        )
