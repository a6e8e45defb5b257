"""Dense correspondence between two scanned surfaces from a few landmarks."""

import itertools
import warnings
from collections.abc import Sequence
from functools import partial

import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, ScalarLike

from .._input.numbers import Numbers, as_numbers
from .._input.precision import check_x64
from .._objective.make_problem import make_problem, with_tension
from .._objective.problem import Problem
from .._objective.wavelengths import lambda_of_wavelength, mean_spacing
from .._programs.sizes import power_of_four
from .._selection.choice import CrossValidation
from .._selection.leave_one_out import leave_one_out
from .._selection.one_fit import RTOL
from .._solver.evaluation import evaluate
from .._solver.model import RegressionMap
from .._solver.solve import solve
from .._sources.sources import Ambient
from ..manifolds import PointCloud
from ..manifolds._scans.surface import SurfaceLike
from .folds import agreement, without_folds
from .given import given_surface, on_piece, one_piece
from .landmark_pairs import landmark_pairs
from .landmarks import LandmarksLike
from .registration import Registration
from .surface_rounds import SurfaceFit, fit_surface

FEWEST_POINTS = 8192  # targets are padded: similar ones share compiled programs


def register(
    source: SurfaceLike,
    target: SurfaceLike,
    source_landmarks: LandmarksLike,
    target_landmarks: LandmarksLike,
    lam: ScalarLike | None = None,
    *,
    sigma: Numbers | None = None,
    precision: Numbers | None = None,
    geometry: str | Sequence[str] = "ambient",
    centres: int | Sequence[int] = 400,
    tension: float | Sequence[float] = 1.0,
    surface: bool = False,
    no_folds: bool = False,
    progress: bool = True,
) -> Registration:
    """Learn the map from one surface to another that is smoothest in the sense of the
    Eells energy and sends landmarks to landmarks (paper, section 5).

    **Arguments:**

    - `source`, `target`: what `load_surface` takes (meshes, files, point clouds), or what
      it returns.
    - `source_landmarks`, `target_landmarks`: files for `read_landmarks`, what it returns,
      l vertex numbers, or positions `(l, 3)`; at least 5 pairs. Landmarks with names are
      matched by them, those on one surface only are left out; others match in order.
      Positions may lie up to a fiftieth of the size away from the surface. Numbers are
      those of the mesh or of the file as it is (from 0; seams of a texture, unused and
      doubled vertices count), also for `PointCloud.from_mesh`. STL files have none.
    - `lam`: lambda, or None to choose it by `leave_one_out` over the landmarks.
    - `sigma`: how far off landmarks are, in the unit of the target: one number, or `(l,)`
      in the order of `source_landmarks`; only ratios count.
    - `precision`: `(l, 3, 3)` inverse covariances in its place, for landmarks that are
      sharp in one direction only, as on an edge.
    - `geometry`: `"ambient"` (default) penalises bending in all directions of space,
      `"intrinsic"` the Eells energy of the surface itself, which lets it bend freely, on
      its largest component.
    - `centres`: about how many local polynomials, at most one a vertex (on a `PointCloud`
      without triangles one for twelve points); cost and detail grow with them. They
      and the smoothness follow the landmarks (`graded` in `make_problem`), so lambda and
      `.model.energies` are means with that weight.
    - `tension`: of the ambient energy, as in `make_problem`: holds on to the affine map of
      the landmarks where there are none. On heads 1 was better than 0, the Eells energy
      alone; where a surface bends far, a sheet onto a cylinder, it was worse.
    - `surface`: True: after the landmarks, the whole target. Sixty rounds match places of
      the two surfaces that are near in position and normal, both ways, and move the source
      towards its matches by smooth steps, large parts first (see `match_weights`). On
      faces that was two to three times as accurate as landmarks alone, with few vertices
      or few features it gains nothing, and it can lose: hold out landmarks to see. Lambda
      is then not chosen by leaving out but set to follow landmarks as far as they are
      apart, unless it is given or there are several of what follows below; geometry and
      tension are those of the start.

    - `no_folds`: True: where triangles come out folded over, lambda is raised (above the
      one chosen) until none is. A warning says how many are left where that ends in none
      without, as on targets thinner than the landmarks are precise.

    Several geometries, numbers of centres or tensions, `geometry=("ambient",
    "intrinsic")`, `centres=(200, 400)`, `tension=(0, 1)`, are tried in all combinations,
    and the one that predicts left-out landmarks best is kept.

    No alignment is needed before: the affine map of the landmarks costs nothing. But
    surfaces have to have the same orientation: of a mirror image the triangles would come
    out inside out.

        found = mr.register("mean.ply", "anna.ply", "mean.mrk.json", "anna.mrk.json")
        found.vertices  # where each vertex of mean.ply belongs on anna.ply

    **Warns** (UserWarning) of repairs that may change results (see `load_surface`), of
    landmarks without a partner, off the surface, in another coordinate system than it, or
    that do not go with the others (swapped, given twice, misplaced), and if the fit kept
    had not settled: `.model.result` is then not `successful`, as after `solve(...,
    throw=False)`; with `no_folds` if folds are left.
    **Raises** ValueError for landmarks that are too few, off the surface, NaN or on one
    line, for meshes of opposite orientation, and for what `load_surface` and
    `read_landmarks` reject; RuntimeError for a fit that ends in NaN.
    """
    check_x64()
    choices = _choices(geometry, centres, tension)
    ours, theirs = given_surface("source", source), given_surface("target", target)
    onto = theirs.cloud
    pairs = landmark_pairs(ours, theirs, source_landmarks, target_landmarks)
    x, y = pairs.x, pairs.y
    sigma, precision = (_of_pairs(a, pairs.numbers) for a in (sigma, precision))
    pieces = {of: ours if of == "ambient" else one_piece(ours) for of, _ in choices}
    places = {of: on_piece(piece, ours, x, pairs.names) for of, piece in pieces.items()}
    padded = onto.padded(power_of_four(len(onto.points), least=FEWEST_POINTS))
    several = sum(map(len, choices.values())) > 1
    found: list[tuple[str, RegressionMap, CrossValidation | None]] = []
    for (of, count), taus in choices.items():
        cloud = pieces[of].cloud
        problem = make_problem(
            Ambient(cloud) if of == "ambient" else cloud,
            padded,
            places[of],
            y,
            sigma=sigma,
            precision=precision,
            centres=count,
            degree=1,
            graded=True,
            tension=max(taus),
        )
        nothing = jnp.zeros((problem.pattern.size, 3))
        if not evaluate(problem.basis, nothing, cloud.points, problem.origin)[1]:
            raise ValueError(
                "source: some vertices lie outside the support of every centre; take more "
                "`centres`."
            )
        for tau in taus:
            taut = problem if tau == max(taus) else with_tension(problem, tau)
            if several or (lam is None and not surface):
                lams = None if lam is None else jnp.atleast_1d(lam)
                cv = leave_one_out(taut, lams, progress=progress)
                found.append((of, cv.model, cv))
            else:
                at = _following(taut) if lam is None else lam
                model = solve(taut, at, starts=(1.0,), rtol=RTOL, throw=False)
                found.append((of, model, None))
    of, model, cv = min(found, key=lambda fit: _predicted_error(fit[2]))
    _check_result(model)
    piece, at = pieces[of], places[of]
    fits = partial(_landmarks_alone, model)
    if surface:
        most = max(count for _, count in choices)
        psi = _psi(model, piece.cloud)
        fits = lambda stiffer, _: fit_surface(
            piece.cloud, onto, padded, at, y, psi, most, progress, stiffer
        )
    fit, left = fits(1.0, None), 0
    image = lambda model: np.asarray(padded.project(_psi(model, piece.cloud)))[
        piece.of_vertex
    ]
    if no_folds and piece.faces is not None:
        faces = piece.faces
        turned = lambda fit: agreement(image(fit.model), faces, onto) < 0
        fit, left = without_folds(fit, lambda fit: int(np.sum(turned(fit))), fits)
    if left:
        _warn_of_folds(left)
    errors = np.linalg.norm(np.asarray(fit.model(at)) - y, axis=1)
    weights = fit.match_weights
    weights = None if weights is None else weights[piece.of_vertex]
    vertices = image(fit.model)
    known = piece, theirs, pairs.names
    return Registration(vertices, fit.model, cv, errors, weights, *known)


def _landmarks_alone(
    model: RegressionMap, stiffer: float, near: SurfaceFit | None
) -> SurfaceFit:
    """The map at so many times its lambda."""
    if stiffer == 1 or model.problem is None:
        return SurfaceFit(model, None)
    warm = model.coefficients if near is None else near.model.coefficients
    options = {"starts": (), "warm": warm, "rtol": RTOL, "throw": False}
    return SurfaceFit(solve(model.problem, stiffer * model.lam, **options), None)


def _psi(model: RegressionMap, cloud: PointCloud) -> Float[Array, "n 3"]:
    return evaluate(model.basis, model.coefficients, cloud.points, model.origin)[0]


def _following(problem: Problem):
    """The lambda at which waves as long as the landmarks are apart are still followed."""
    return lambda_of_wavelength(problem, mean_spacing(problem))


def _warn_of_folds(left: int) -> None:
    warnings.warn(
        f"register: no_folds cannot be kept: {left} triangles are folded over at the best "
        "stiffness tried, and a larger one does not help: the target is folded closer "
        "than landmarks tell, or landmarks contradict each other. `.report().folded` has "
        "them; add landmarks there.",
        stacklevel=3,
    )


def _of_pairs(value: Numbers | None, index: list[int]) -> np.ndarray | None:
    """What is given for each landmark of the source, for those in pairs."""
    if value is None:
        return None
    array = as_numbers("sigma, precision", value)
    whole = array.ndim > 0 and len(array) > max(index)
    return array[index] if whole else array


def _check_result(model: RegressionMap) -> None:
    if not np.all(np.isfinite(model.coefficients)):
        raise RuntimeError(
            f"register: the fit at lambda {float(model.lam):.3g} ends in NaN; take a "
            "larger `lam`, fewer `centres` or more `tension`."
        )
    if model.result != optx.RESULTS.successful:
        warnings.warn(
            f"register: the fit at lambda {float(model.lam):.3g} had not settled after "
            f"{int(model.stats['num_trials'])} steps, so vertices may be off, most where "
            "the target is thin or folded. Take a larger `lam`, fewer `centres` or more "
            "`tension`; `.model.result` tells.",
            stacklevel=3,
        )


def _choices(geometry, centres, tension) -> dict[tuple[str, int], tuple[float, ...]]:
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


def _predicted_error(cv: CrossValidation | None) -> float:
    """Of left-out landmarks; with nothing to choose, of no interest."""
    if cv is None:
        return 0.0
    return float(cv.criterion[cv.chosen])
