"""Dense correspondence between two scanned surfaces from a few landmarks."""

import itertools
import warnings
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import trimesh
from jaxtyping import ArrayLike, Float, Int, ScalarLike

from .._input.precision import check_x64
from .._objective.make_problem import make_problem, with_tension
from .._programs.sizes import power_of_four
from .._selection.choice import CrossValidation
from .._selection.leave_one_out import leave_one_out
from .._selection.one_fit import RTOL
from .._solver.evaluation import evaluate
from .._solver.model import RegressionMap
from .._solver.solve import solve
from .._sources.sources import Ambient
from ..manifolds import PointCloud
from .certificate import Certificate, certificate_of
from .folds import agreement, without_folds
from .given import (
    GivenSurface,
    Surface,
    given_surface,
    landmark_positions,
    normals_at,
)
from .orientation import check_orientation

FEWEST_POINTS = 8192  # targets are padded: similar ones share compiled programs


class Registration(eqx.Module):
    """Where every vertex of the source belongs on the target."""

    vertices: Float[np.ndarray, "n 3"]
    """On the target, numbered as the vertices of the source are in its mesh or file; a
    vertex that no triangle uses goes with the nearest one that is used."""
    model: RegressionMap
    """The map itself, for any point of the source."""
    cv: CrossValidation | None
    """How lambda was chosen; None if it was given."""
    landmark_errors: Float[np.ndarray, " l"]
    """Distances on the target between where the landmarks are sent and belong."""
    match_weights: Float[np.ndarray, " n"] | None
    """With `surface=True`: how far each vertex has a match on the target, 1, or is an
    outlier or beyond its edge, 0."""
    source_vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "f 3"] | None
    source: GivenSurface
    target: GivenSurface

    def report(self, inverse: "Registration | None" = None) -> Certificate:
        """How good it is: folds, stretches, distances both ways, landmarks left out, 95 %
        radii; see `Certificate`. Half a minute for 20,000 vertices.

        - `inverse`: the registration of the target onto the source, `register(target,
          source, target_landmarks, source_landmarks)`, to go there and back.

        **Raises** ValueError for an `inverse` of other surfaces."""
        if inverse is not None:
            ours, theirs = inverse.target.vertices, inverse.source.vertices
            same = np.array_equal(ours, self.source.vertices)
            if not (same and np.array_equal(theirs, self.target.vertices)):
                raise ValueError(
                    "inverse: not from this target onto this source; give "
                    "`register(target, source, ...)` of the same two surfaces."
                )
        return certificate_of(
            self.model,
            self.vertices,
            self.source,
            self.target,
            len(self.landmark_errors),
            self.match_weights,
            None if inverse is None else inverse.model,
        )

    def mesh(self, t: float = 1.0) -> trimesh.Trimesh:
        """The source's triangles at (1 - t) source + t target: t = 1 is the registered
        mesh, 0.5 the morph half way, t > 1 a caricature. To write it far from the origin
        without loss take `manireg.meshes.write_mesh`."""
        if self.faces is None:
            raise ValueError("mesh: the source is a point cloud without triangles.")
        between = (1 - t) * self.source_vertices + t * self.vertices
        return trimesh.Trimesh(between, self.faces, process=False)

    def stretch(self) -> Float[np.ndarray, " f"]:
        """Area of each triangle on the target relative to its area on the source."""
        return self.mesh(1.0).area_faces / np.maximum(self.mesh(0.0).area_faces, 1e-300)


def register(
    source: Surface,
    target: Surface,
    source_landmarks: ArrayLike,
    target_landmarks: ArrayLike,
    lam: ScalarLike | None = None,
    *,
    geometry: str | Sequence[str] = "ambient",
    centres: int | Sequence[int] = 400,
    tension: float | Sequence[float] = 1.0,
    no_folds: bool = False,
    progress: bool = True,
) -> Registration:
    """Learn the map from one surface to another that is smoothest in the sense of the
    Eells energy and sends landmarks to landmarks (paper, section 5).

    **Arguments:**

    - `source`, `target`: meshes (`trimesh.Trimesh`, or files trimesh loads) or
      `PointCloud`s.
    - `source_landmarks`, `target_landmarks`: l vertex numbers, or positions `(l, 3)` up
      to a hundredth of the size away from the surface; at least 5 pairs. Numbers are those
      of the mesh or of the file as it is (from 0; seams of a texture, unused and doubled
      vertices count), also for `PointCloud.from_mesh`. STL files have none.
    - `lam`: lambda, or None to choose it by `leave_one_out` over the landmarks.
    - `geometry`: `"ambient"` (default) penalises bending in all directions of space,
      `"intrinsic"` the Eells energy of the surface itself, which lets it bend freely.
    - `centres`: about how many local polynomials, at most one a vertex (on a `PointCloud`
      without triangles one for twelve points); cost and detail grow with them. They
      and the smoothness follow the landmarks (`graded` in `make_problem`), so lambda and
      `.model.energies` are means with that weight.
    - `tension`: of the ambient energy, as in `make_problem`: holds on to the affine map of
      the landmarks where there are none. On heads 1 was better than 0, the Eells energy
      alone; where a surface bends far, a sheet onto a cylinder, it was worse.

    - `no_folds`: True: where triangles come out folded over, lambda is raised (above the
      one chosen) until none is. A warning says how many are left where that ends in none
      without, as on targets thinner than the landmarks are precise.

    Several geometries, numbers of centres or tensions, `geometry=("ambient",
    "intrinsic")`, `centres=(200, 400)`, `tension=(0, 1)`, are tried in all combinations,
    and the one that predicts left-out landmarks best is kept.

    No alignment is needed before: the affine map of the landmarks costs nothing. But
    surfaces have to have the same orientation: of a mirror image the triangles would come
    out inside out.

    **Warns** (UserWarning) if the fit kept had not settled: `.model.result` is then not
    `successful`, as after `solve(..., throw=False)`; with `no_folds` if folds are left.
    **Raises** ValueError for landmarks that are too few, off the surface, NaN or on one
    line, for meshes of opposite orientation, and for what `PointCloud` rejects;
    RuntimeError for a fit that ends in NaN.
    """
    check_x64()
    ours, theirs = given_surface("source", source), given_surface("target", target)
    cloud, onto = ours.cloud, theirs.cloud
    x = landmark_positions("source_landmarks", source_landmarks, ours)
    y = landmark_positions("target_landmarks", target_landmarks, theirs)
    if len(x) != len(y) or len(x) < 5:
        raise ValueError(
            f"landmarks: at least 5 pairs are needed, found {len(x)} on the source and "
            f"{len(y)} on the target."
        )
    for name, places in (("source_landmarks", x), ("target_landmarks", y)):
        spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if spread[1] <= 1e-3 * spread[0]:
            raise ValueError(f"{name}: all on one line; spread them out.")
    if ours.faces is not None:
        check_orientation(x, y, normals_at(cloud, x), normals_at(onto, y))
    padded = onto.padded(power_of_four(len(onto.points), least=FEWEST_POINTS))
    choices = _choices(geometry, centres, tension)
    several = sum(map(len, choices.values())) > 1
    found: list[tuple[RegressionMap, CrossValidation | None]] = []
    for (of, count), taus in choices.items():
        problem = make_problem(
            _with_geometry(cloud, of),
            padded,
            x,
            y,
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
            if lam is None or several:
                lams = None if lam is None else jnp.atleast_1d(lam)
                cv = leave_one_out(taut, lams, progress=progress)
                found.append((cv.model, cv))
            else:
                model = solve(taut, lam, starts=(1.0,), rtol=RTOL, throw=False)
                found.append((model, None))
    model, cv = min(found, key=lambda fit: _predicted_error(fit[1]))
    _check_result(model)
    image = lambda model: _image(model, ours, onto)
    if no_folds and ours.faces is not None:
        faces = ours.faces
        folds = lambda m: int(np.sum(agreement(image(m), faces, onto) < 0))
        model, left = without_folds(model, folds)
        if left:
            _warn_of_folds(left, model)
    errors = np.linalg.norm(np.asarray(model(x)) - y, axis=1)
    return Registration(
        image(model),
        model,
        cv,
        errors,
        None,
        ours.vertices,
        ours.faces,
        ours,
        theirs,
    )


def _image(model: RegressionMap, source: GivenSurface, onto: PointCloud) -> np.ndarray:
    """Of the vertices of the source."""
    points = source.cloud.points
    psi = evaluate(model.basis, model.coefficients, points, model.origin)[0]
    return np.asarray(onto.project(psi))[source.of_vertex]


def _warn_of_folds(left: int, model: RegressionMap) -> None:
    warnings.warn(
        f"register: no_folds cannot be kept: {left} triangles are folded over at the best "
        f"lambda tried ({float(model.lam):.3g}), and a larger one does not help: the "
        "target is folded closer than landmarks tell, or landmarks contradict each other. "
        "`.report().folded` has them; add landmarks there.",
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


def _choices(geometry, centres, tension) -> dict[tuple[str, int], tuple[float, ...]]:
    """Tensions to be tried with each geometry and number of centres; the intrinsic energy
    has none."""
    several = lambda value: (value,) if np.ndim(value) == 0 else tuple(value)
    taus = {"ambient": tuple(dict.fromkeys(several(tension)))}
    pairs = itertools.product(several(geometry), several(centres))
    return {(of, n): taus.get(of, (0.0,)) for of, n in pairs}


def _with_geometry(cloud: PointCloud, geometry: str):
    if geometry not in ("ambient", "intrinsic"):
        raise ValueError(
            f"geometry: expected 'ambient' or 'intrinsic', found {geometry!r}."
        )
    return Ambient(cloud) if geometry == "ambient" else cloud


def _predicted_error(cv: CrossValidation | None) -> float:
    """Of left-out landmarks; with nothing to choose, of no interest."""
    if cv is None:
        return 0.0
    return float(cv.criterion[cv.chosen])
