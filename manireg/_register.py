"""Dense correspondence between two scanned surfaces from a few landmarks."""

import itertools
from collections.abc import Sequence
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import trimesh
from jaxtyping import ArrayLike, Float, Int, ScalarLike

from ._checks import check_landmarks
from ._leave_one_out import RTOL, cut_errors, leave_one_out
from ._problem import make_problem
from ._selection import CrossValidation
from ._solve import RegressionMap, evaluate, solve
from ._sources import Ambient
from .manifolds import PointCloud
from .manifolds._meshes import as_mesh

PAD = 8192  # targets are padded to multiples: similar ones share compiled programs

Surface = trimesh.Trimesh | PointCloud | str | Path


class Registration(eqx.Module):
    """Where every vertex of the source belongs on the target."""

    vertices: Float[np.ndarray, "n 3"]
    """On the target, in the order of the source's vertices."""
    model: RegressionMap
    """The map itself, for any point of the source."""
    cv: CrossValidation | None
    """How lambda was chosen; None if it was given."""
    landmark_errors: Float[np.ndarray, " l"]
    """Distances on the target between where the landmarks are sent and belong."""
    source_vertices: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "f 3"] | None

    def mesh(self, t: float = 1.0) -> trimesh.Trimesh:
        """The source's triangles at (1 - t) source + t target: t = 1 is the registered
        mesh, 0.5 the morph half way, t > 1 a caricature."""
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
    progress: bool = True,
) -> Registration:
    """Learn the map from one surface to another that is smoothest in the sense of the
    Eells energy and sends landmarks to landmarks (paper, section 5).

    **Arguments:**

    - `source`, `target`: meshes (`trimesh.Trimesh`, or files trimesh loads) or
      `PointCloud`s.
    - `source_landmarks`, `target_landmarks`: l vertex numbers, or positions `(l, 3)` up
      to a hundredth of the size away from the surface; at least 5 pairs.
    - `lam`: lambda, or None to choose it by `leave_one_out` over the landmarks.
    - `geometry`: `"ambient"` (default) penalises bending in all directions of space,
      `"intrinsic"` the Eells energy of the surface itself, which lets it bend freely.
    - `centres`: about how many local polynomials; cost and detail grow with them. They
      and the smoothness follow the landmarks (`graded` in `make_problem`), so lambda and
      `.model.energies` are means with that weight.
    - `tension`: of the ambient energy, as in `make_problem`: holds on to the affine map of
      the landmarks where there are none. On heads 1 was better than 0, the Eells energy
      alone; where a surface bends far, a sheet onto a cylinder, it was worse.

    Several geometries, numbers of centres or tensions, `geometry=("ambient",
    "intrinsic")`, `centres=(200, 400)`, `tension=(0, 1)`, are tried in all combinations,
    and the one that predicts left-out landmarks best is kept.

    No alignment is needed before: the affine map of the landmarks costs nothing.
    **Raises** ValueError for landmarks that are too few, off the surface, NaN or on one
    line, and for what `PointCloud` rejects.
    """
    cloud, start, faces = _surface(source)
    onto, end, _ = _surface(target)
    x = _positions("source_landmarks", source_landmarks, start, cloud)
    y = _positions("target_landmarks", target_landmarks, end, onto)
    if len(x) != len(y) or len(x) < 5:
        raise ValueError(
            f"landmarks: at least 5 pairs are needed, found {len(x)} on the source and "
            f"{len(y)} on the target."
        )
    if np.linalg.matrix_rank(x - x.mean(0), tol=1e-3 * np.ptp(x)) < 2:
        raise ValueError("source_landmarks: all on one line; spread them out.")
    padded = onto.padded(-(-len(onto.points) // PAD) * PAD)
    choices = _choices(geometry, centres, tension)
    found: list[tuple[RegressionMap, CrossValidation | None]] = []
    for of, count, tau in choices:
        problem = make_problem(
            _with_geometry(cloud, of),
            padded,
            x,
            y,
            centres=count,
            degree=1,
            graded=True,
            tension=tau,
        )
        nothing = jnp.zeros((problem.pattern.size, 3))
        if not evaluate(problem.basis, nothing, jnp.asarray(start), problem.origin)[1]:
            raise ValueError(
                "source: some vertices lie outside the support of every centre. Drop "
                "vertices that no triangle uses (mesh.remove_unreferenced_vertices()), or "
                "take more `centres`."
            )
        if lam is None or len(choices) > 1:
            lams = None if lam is None else jnp.atleast_1d(lam)
            cv = leave_one_out(problem, lams, progress=progress)
            found.append((cv.model, cv))
        else:
            model = solve(problem, lam, starts=(1.0,), rtol=RTOL, throw=False)
            found.append((model, None))
    model, cv = min(found, key=lambda fit: _predicted_error(fit[1]))
    image = onto.project(
        evaluate(model.basis, model.coefficients, jnp.asarray(start), model.origin)[0]
    )
    errors = np.linalg.norm(np.asarray(model(x)) - y, axis=1)
    return Registration(np.asarray(image), model, cv, errors, start, faces)


def _choices(geometry, centres, tension) -> list[tuple[str, int, float]]:
    """All combinations; the intrinsic energy has no tension."""
    several = lambda value: (value,) if np.ndim(value) == 0 else tuple(value)
    products = itertools.product(*map(several, (geometry, centres, tension)))
    return list(
        dict.fromkeys(
            (of, n, tau if of == "ambient" else 0.0) for of, n, tau in products
        )
    )


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
    return float(cut_errors(np.asarray(cv.scores[:, cv.chosen])).mean())


def _surface(surface: Surface):
    """As a point cloud, with the vertices and triangles it was given by."""
    if isinstance(surface, PointCloud):
        return surface, np.asarray(surface.points), None
    mesh = as_mesh(surface)
    vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces)
    return PointCloud.from_mesh(mesh), vertices, faces


def _positions(name: str, landmarks, vertices, cloud: PointCloud) -> np.ndarray:
    """Landmarks as points of the surface."""
    landmarks = np.asarray(landmarks)
    if landmarks.ndim == 1 and landmarks.dtype.kind in "iu":
        wrong = landmarks[(landmarks < 0) | (landmarks >= len(vertices))]
        if len(wrong):
            raise ValueError(
                f"{name}: vertex {wrong[0]} does not exist; there are {len(vertices)}."
            )
        positions = vertices[landmarks]
    elif landmarks.ndim == 2 and landmarks.shape[1] == 3:
        positions = landmarks.astype(float)
    else:
        raise ValueError(
            f"{name}: expected vertex numbers (l,) or positions (l, 3), found shape "
            f"{landmarks.shape} of {landmarks.dtype}."
        )
    if not np.all(np.isfinite(positions)):
        raise ValueError(f"{name}: NaN or infinity; remove these pairs.")
    return check_landmarks(name, cloud, positions)
