"""A fit in its order: lambda chosen or given, then the noise, then errors of inputs, each
started from the map before."""

import dataclasses
from typing import Any, Literal

from .._input.numbers import Numbers
from .._objective.make_problem import make_problem
from .._objective.problem import Problem
from .._objective.robust import Squared, check_loss
from .._objective.wavelengths import check_one, given_lambda
from .._solver.geodesic_loss import solve_geodesic
from .._solver.model import RegressionMap
from .._solver.solve import checked, solve
from .._source import AbstractSource
from .._sources.checks import check_points
from .._sources.input_errors import check_input_errors
from ..manifolds import AbstractManifold
from .choice import CrossValidation
from .criteria import CriterionName, RestrictedLikelihood, criterion_of
from .cross_validate import cross_validate
from .effective_variance import with_effective_variance
from .latent_inputs import with_latent_inputs
from .leave_one_out import along_path
from .noise import Again, Scatter, blunted, check_scatter, with_estimated_noise
from .one_fit import STEPS_TO_THE_END, OneFit
from .orders import Order, over_orders

CALLS = 7  # from a choice along the path to the user's line


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
    wavelength: Numbers | None = None,
    **options,
) -> tuple[RegressionMap, CrossValidation | None]:
    """What `fit` does, with the last choice of lambda before errors in x were looked at;
    None where it was given. `data`: arguments of `make_problem`, and the order or
    orders."""
    data = {"order": 2, "loss": "squared"} | data
    known = lam is not None or wavelength is not None
    if known:
        check_one(lam, wavelength)
    _check(known, data["order"], distance, folds, data["loss"], criterion)
    check_scatter(scatter)
    inexact = _input_errors(source, x, x_sigma, x_min, x_max, x_error)
    problem, choices = (source, target, x, y), []
    progress = options.get("progress", True)
    if known:
        if inexact is not None:  # one fit has none to show, those of latent inputs have
            options.pop("progress", None)
        size = lam, wavelength
        model, again = _given(*problem, size, distance, data, options)
    elif folds is not None:
        model, again = _by_folds(*problem, folds, data, options, choices)
    else:
        model, again = _along_path(*problem, criterion, data, options, choices)
    model = with_estimated_noise(model, again, scatter)
    if inexact is not None and x_error == "effective":
        model = with_effective_variance(model, inexact, again, scatter)
    elif inexact is not None:
        model = with_latent_inputs(model, inexact, not known, scatter, progress)
    if not choices:
        return model, None
    return model, dataclasses.replace(choices[-1], others=choices[0].others)


def _given(
    source, target, x, y, size, distance, data, options
) -> tuple[RegressionMap, Again]:
    """The fit at a lambda, and how to repeat it near a map. `size`: lambda or a
    wavelength."""
    minimise = solve_geodesic if distance == "geodesic" else solve
    first = blunted(make_problem(source, target, x, y, **data))
    lam = given_lambda(first, *size)
    model = minimise(first, lam, **options)
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
        # squares of outliers, left out, are lowest under maps that go through all data
        robust = warm is None and not problem.misfit.squared
        by = RestrictedLikelihood() if robust else judge
        score = OneFit(problem, by, linear_algebra, max_steps, warm)
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
    known: bool, order: Order, distance: str, folds: int | None, loss, criterion: str
) -> None:
    if distance not in ("chord", "geodesic") or (distance == "geodesic" and not known):
        raise ValueError(
            "distance: expected 'chord' or, with a given `lam`, 'geodesic'; found "
            f"{distance!r}."
        )
    if folds is not None and known:
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
    if known and not isinstance(order, int):
        raise ValueError(
            f"order: give one where `lam` is given, found {order!r}; lambda has a unit of "
            "its own for each."
        )
