"""The whole target surface as data: from a map that is nearly right, many small steps."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import ArrayLike, Float
from tqdm import tqdm

from .._objective.arguments import argument
from .._objective.make_problem import make_problem
from .._objective.objective import objective
from .._objective.problem import Problem
from .._objective.wavelengths import lambda_of_wavelength
from .._programs.program import program
from .._solver.minimise import gauge, stage_of
from .._solver.model import RegressionMap, regression_map
from .._sources.sources import Ambient
from ..manifolds import PointCloud
from .correspondence import Matches, OrientedPoints, matches, oriented
from .linear_map import linear_map
from .scans import Onto

ROUNDS = 60
# In radii of gyration of the source, so that neither unit nor sampling matters; in the
# root of its area bone, of several sheets, would be twice as large as it is:
VISCOUS = (1.45, 0.53)  # wavelengths below which a round does not move, first and last
START = 0.265  # wavelength below which the start is smoothed: rounds would leave it
ELASTIC = 0.145  # wavelength below which the map does not bend
NORMAL_LENGTH = 0.058  # what a normal off by a radian is worth


class SurfaceFit(NamedTuple):
    """A map onto the whole target."""

    model: RegressionMap
    match_weights: Float[np.ndarray, " n"] | None
    """Of each point of the source, between 0 and 1; None of landmarks alone."""


def fit_surface(
    source: PointCloud,
    onto: Onto,
    x: Float[np.ndarray, "l 3"],
    y: Float[np.ndarray, "l 3"],
    start: Float[ArrayLike, "n 3"],
    centres: int,
    progress: bool,
    stiffer: float = 1.0,
) -> SurfaceFit:
    r"""From `start`, where the points of the source are sent at first: `ROUNDS` times the
    `matches` y' of all points, and the minimiser of

    $$\tfrac12 \sum_i \omega_i |\Psi(x_i) - y'_i|^2
      + \tfrac1{2l} \sum_j |\Psi(X_j) - Y_j|^2
      + \lambda \int |D^2 \Psi|^2 + \mu \int |D^2 (\Psi - \Psi_0)|^2$$

    with $\Psi_0$ the map of the round before and omega the areas times the weights of
    the matches, of sum 1: landmarks weigh as much as the surface does. Lambda is small and
    stays; mu falls from round to round, so that large parts move first and details last.
    It is the change that is kept smooth: maps that a smooth flow reaches cost nothing,
    and matches, which hold on to where they are, give way to what all of them say.

    `stiffer`: times lambda. What the rounds end in is no minimiser of one objective; its
    `problem` has the last matches as data, with their weights.
    """
    points, share = np.asarray(source.points), np.asarray(source.areas)
    share = share / np.sum(share)
    nearest = np.asarray(onto.padded.nearest(jnp.asarray(start)))
    problem = make_problem(
        Ambient(source),
        onto.padded,
        np.concatenate([points, x]),
        np.concatenate([np.asarray(onto.cloud.points)[nearest], y]),
        weights=_weights(share, len(x)),
        centres=centres,
        degree=1,
    )
    space = linear_map(problem)
    radius = radius_of_gyration(points, share)
    first, lam, viscosities = _schedule(problem, radius)
    start, lam = np.asarray(start), stiffer * lam
    aims = np.concatenate([start, y])
    w = space.fitted(aims, np.asarray(problem.weights), first)
    theirs, edge = oriented(onto.cloud), oriented(source).on_edge
    length = NORMAL_LENGTH * radius
    normals = np.concatenate([np.asarray(source.normals), np.zeros_like(x)])
    found = Matches(points, share)
    for viscosity in tqdm(viscosities, "surface", disable=not progress, leave=False):
        here, turned = space.at_data(w), space.normals(w, normals)
        ours = OrientedPoints(here[: len(points)], turned[: len(points)], edge)
        found = matches(ours, theirs, length)
        weights = _weights(share * found.weights, len(x))
        aims = np.concatenate([found.points, y])
        w = space.fitted(aims, weights, lam, viscosity, w)
    problem = _with_matches(problem, found, y, _weights(share * found.weights, len(x)))
    return SurfaceFit(_model(problem, w, lam), found.weights)


def _weights(surface: Float[np.ndarray, " n"], landmarks: int) -> np.ndarray:
    """Of points and landmarks: each of the two half of all, where there are both."""
    surface = surface / max(np.sum(surface), np.finfo(float).tiny)
    if landmarks == 0:
        return surface
    return 0.5 * np.concatenate([surface, np.full(landmarks, 1 / landmarks)])


def radius_of_gyration(
    points: Float[np.ndarray, "n 3"], share: Float[np.ndarray, " n"]
) -> float:
    """Root mean square distance from the centroid, of shares of sum 1."""
    return float(np.sqrt(share @ np.sum((points - share @ points) ** 2, axis=1)))


def _schedule(problem: Problem, radius: float) -> tuple[float, float, np.ndarray]:
    """Lambda of the start and of the rounds, and the viscosity of each round."""
    of_wavelength = lambda part: float(lambda_of_wavelength(problem, part * radius))
    first, last = map(of_wavelength, VISCOUS)
    viscosities = np.geomspace(first, last, ROUNDS)
    return of_wavelength(START), of_wavelength(ELASTIC), viscosities


def _with_matches(problem: Problem, found: Matches, y, weights) -> Problem:
    onto = np.asarray(problem.target.project(jnp.asarray(found.points)))
    new = jax.device_put((np.concatenate([onto, y]), weights))
    return eqx.tree_at(lambda p: (p.y, p.weights), problem, new)


def _model(problem: Problem, coefficients: np.ndarray, lam: float) -> RegressionMap:
    w, at = jnp.asarray(coefficients), jnp.asarray(lam)
    energies = _energies(argument(problem), at, w)
    stats = {"num_steps": np.array(ROUNDS)}
    return regression_map(problem, w, at, energies, optx.RESULTS.successful, stats)


@program(most=4)
def _energies(problem, lam, w):
    stage = stage_of(problem, lam, gauge(problem), "projected", w)
    return objective(w, stage)[1]
