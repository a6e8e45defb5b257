"""Dense correspondence between two scanned surfaces from a few landmarks."""

import warnings
from collections.abc import Sequence
from functools import partial

import numpy as np
import optimistix as optx
from jaxtyping import ArrayLike, ScalarLike

from .._input.numbers import Numbers
from .._input.precision import check_x64
from .._selection.one_fit import RTOL
from .._solver.model import RegressionMap
from .._solver.solve import solve
from ..manifolds._scans.surface import SurfaceLike
from .align import moved_by
from .folds import agreement, without_folds
from .given import given_surface
from .held_out import check_enough, held_out
from .landmark_fit import choices_of, errors_at, landmark_fit, unprojected
from .landmark_pairs import landmark_pairs, nothing_paired
from .landmarks import LandmarksLike
from .registration import Registration
from .scans import scans_of
from .surface_rounds import SurfaceFit, fit_surface


def register(
    source: SurfaceLike,
    target: SurfaceLike,
    source_landmarks: LandmarksLike | None = None,
    target_landmarks: LandmarksLike | None = None,
    lam: ScalarLike | None = None,
    *,
    sigma: Numbers | None = None,
    precision: Numbers | None = None,
    geometry: str | Sequence[str] = "ambient",
    centres: int | Sequence[int] = 400,
    tension: float | Sequence[float] = 1.0,
    surface: bool | str = False,
    start: ArrayLike | None = None,
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
      faces that was two to three times as accurate as landmarks alone; with few vertices
      or few features it gains nothing, and it can lose. `"auto"`: landmarks are left out,
      a fifth at a time, and predicted with and without the rounds; what predicts them
      better is kept, and `held_out` has the errors (at least 8 landmarks; five times as
      slow). With True, lambda is not chosen by leaving out but set to follow landmarks as
      far as they are apart, unless it is given or there are several of what follows below;
      geometry and tension are those of the start.
    - `start`: without landmarks, a matrix `(4, 4)` that brings the source near the target,
      of `align` or your own (an affine map of homogeneous coordinates); the whole surface
      does the rest, so `surface=True`. Much less sure than five landmarks.
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

    **Example:** a ball onto an ellipsoid, by 11 vertices of each.

    ```python
    ball = trimesh.creation.icosphere(subdivisions=2)
    egg = ball.copy().apply_scale([1.0, 1.2, 0.8])
    marks = np.arange(0, 162, 15)
    found = mr.register(ball, egg, marks, marks, 1e-3)
    np.abs(found.vertices - egg.vertices).max() < 0.05  # True
    ```
    """
    check_x64()
    _check_beginning(source_landmarks, target_landmarks, start, surface)
    choices = choices_of(geometry, centres, tension)
    most = max(count for _, count in choices)
    ours, theirs = given_surface("source", source), given_surface("target", target)
    cv = tried = alone = None
    if source_landmarks is None or target_landmarks is None:
        of, pairs = "ambient", nothing_paired()
        scans = scans_of(ours, theirs, pairs, [of])
        psi = moved_by(start, ours.cloud.points)
    else:
        pairs = landmark_pairs(ours, theirs, source_landmarks, target_landmarks)
        if surface == "auto":
            check_enough(len(pairs.y))
        geometries = dict.fromkeys(of for of, _ in choices)
        scans = scans_of(ours, theirs, pairs, geometries, sigma, precision)
        leave_out = lam is None and surface is not True
        begun = landmark_fit(scans, choices, lam, leave_out, progress)
        _check_result(begun.model)
        of, cv, alone = begun.geometry, begun.cv, begun.model
        psi = unprojected(alone, scans.pieces[of].cloud)
        tried = held_out(scans, begun, most, progress) if surface == "auto" else None
    piece, x = scans.pieces[of], scans.x[of]
    if surface is True or (tried is not None and tried.surface_is_better):
        fits = lambda stiffer, _: fit_surface(
            piece.cloud, scans.onto, x, pairs.y, psi, most, progress, stiffer
        )
    else:
        assert alone is not None
        fits = partial(_landmarks_alone, alone)
    fit, left = fits(1.0, None), 0
    image = lambda model: np.asarray(
        scans.onto.padded.project(unprojected(model, piece.cloud))
    )[piece.of_vertex]
    if no_folds and piece.faces is not None:
        faces = piece.faces
        turned = lambda fit: agreement(image(fit.model), faces, theirs.cloud) < 0
        fit, left = without_folds(fit, lambda fit: int(np.sum(turned(fit))), fits)
    if left:
        _warn_of_folds(left)
    weights = fit.match_weights
    return Registration(
        vertices=image(fit.model),
        model=fit.model,
        cv=cv,
        landmark_errors=errors_at(fit.model, x, pairs.y),
        match_weights=None if weights is None else weights[piece.of_vertex],
        source=piece,
        target=theirs,
        held_out=tried,
        landmark_names=pairs.names,
    )


def _check_beginning(source_landmarks, target_landmarks, start, surface) -> None:
    if surface not in (True, False, "auto"):
        raise ValueError(f"surface: expected True, False or 'auto', found {surface!r}.")
    given = [a is not None for a in (source_landmarks, target_landmarks)]
    if start is None and not all(given):
        raise ValueError(
            "landmarks: give `source_landmarks` and `target_landmarks`, or without any "
            "`start=mr.align(source, target), surface=True`."
        )
    if start is not None and any(given):
        raise ValueError("start: not with landmarks, which know better; leave out one.")
    if start is not None and surface is not True:
        raise ValueError(
            "start: nothing to fit without landmarks but the whole surface; add "
            "`surface=True`."
        )


def _landmarks_alone(
    model: RegressionMap, stiffer: float, near: SurfaceFit | None
) -> SurfaceFit:
    """The map at so many times its lambda."""
    if stiffer == 1 or model.problem is None:
        return SurfaceFit(model, None)
    warm = model.coefficients if near is None else near.model.coefficients
    options = {"starts": (), "warm": warm, "rtol": RTOL, "throw": False}
    return SurfaceFit(solve(model.problem, stiffer * model.lam, **options), None)


def _warn_of_folds(left: int) -> None:
    warnings.warn(
        f"register: no_folds cannot be kept: {left} triangles are folded over at the best "
        "stiffness tried, and a larger one does not help: the target is folded closer "
        "than landmarks tell, or landmarks contradict each other. `.report().folded` has "
        "them; add landmarks there.",
        stacklevel=3,
    )


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
