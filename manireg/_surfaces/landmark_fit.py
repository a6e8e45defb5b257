"""The smoothest map from one surface to another that sends landmarks to landmarks."""

import itertools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, ScalarLike

from .._objective.make_problem import make_problem, with_tension
from .._objective.problem import Problem
from .._objective.wavelengths import lambda_of_wavelength, mean_spacing
from .._selection.choice import CrossValidation
from .._selection.leave_one_out import leave_one_out
from .._selection.one_fit import RTOL
from .._solver.evaluation import evaluate
from .._solver.model import RegressionMap
from .._solver.solve import solve
from .._sources.sources import Ambient
from ..manifolds import PointCloud
from .scans import Scans

Choices = dict[tuple[str, int], tuple[float, ...]]


class LandmarkFit(NamedTuple):
    """What predicts left-out landmarks best."""

    geometry: str
    centres: int
    tension: float
    model: RegressionMap
    cv: CrossValidation | None


def landmark_fit(
    scans: Scans,
    choices: Choices,
    lam: ScalarLike | None,
    leave_out: bool,
    progress: bool,
) -> LandmarkFit:
    """Of all choices. With a single one and not to `leave_out`, lambda is the one given,
    or that at which waves as long as the landmarks are apart are still followed."""
    several = sum(map(len, choices.values())) > 1
    found: list[LandmarkFit] = []
    for (of, count), taus in choices.items():
        problem = _problem(scans, of, count, max(taus))
        for tau in taus:
            taut = problem if tau == max(taus) else with_tension(problem, tau)
            if several or leave_out:
                lams = None if lam is None else jnp.atleast_1d(lam)
                cv = leave_one_out(taut, lams, progress=progress)
                found.append(LandmarkFit(of, count, tau, cv.model, cv))
            else:
                at = _following(taut) if lam is None else lam
                model = solve(taut, at, starts=(1.0,), rtol=RTOL, throw=False)
                found.append(LandmarkFit(of, count, tau, model, None))
    return min(found, key=_predicted_error)


def choices_of(geometry, centres, tension) -> Choices:
    """Tensions to be tried with each geometry and number of centres; the intrinsic energy
    has none."""
    wrong = [g for g in np.atleast_1d(geometry) if g not in ("ambient", "intrinsic")]
    if wrong:
        raise ValueError(
            f"geometry: expected 'ambient' or 'intrinsic', found {str(wrong[0])!r}."
        )
    several = lambda value: (value,) if np.ndim(value) == 0 else tuple(value)
    taus = {"ambient": tuple(dict.fromkeys(several(tension)))}
    pairs = itertools.product(several(geometry), several(centres))
    return {(of, n): taus.get(of, (0.0,)) for of, n in pairs}


def unprojected(model: RegressionMap, cloud: PointCloud) -> Float[Array, "n 3"]:
    """Where the map of space sends the points, before they are projected onto N."""
    return evaluate(model.basis, model.coefficients, cloud.points, model.origin)[0]


def errors_at(
    model: RegressionMap, x: Float[np.ndarray, "l 3"], y: Float[np.ndarray, "l 3"]
) -> Float[np.ndarray, " l"]:
    """Distances between where x are sent and belong."""
    sent = np.asarray(model(x)) if len(x) else x
    return np.linalg.norm(sent - y, axis=1)


def _problem(scans: Scans, geometry: str, centres: int, tension: float) -> Problem:
    cloud = scans.pieces[geometry].cloud
    problem = make_problem(
        Ambient(cloud) if geometry == "ambient" else cloud,
        scans.onto.padded,
        scans.x[geometry],
        scans.y,
        sigma=scans.sigma,
        precision=scans.precision,
        centres=centres,
        degree=1,
        graded=True,
        tension=tension,
    )
    nothing = jnp.zeros((problem.pattern.size, 3))
    if not evaluate(problem.basis, nothing, cloud.points, problem.origin)[1]:
        raise ValueError(
            "source: some vertices lie outside the support of every centre; take more "
            "`centres`."
        )
    return problem


def _following(problem: Problem) -> ScalarLike:
    return lambda_of_wavelength(problem, mean_spacing(problem))


def _predicted_error(fit: LandmarkFit) -> float:
    """Of left-out landmarks; with nothing to choose, of no interest."""
    return 0.0 if fit.cv is None else float(fit.cv.criterion[fit.cv.chosen])
