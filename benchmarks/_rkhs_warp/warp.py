"""Warping space with kernels until one surface lies on another."""

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from manireg._discretisation.spacing import farthest_indices
from manireg._input.numbers import Numbers
from manireg._input.precision import check_x64
from manireg.baselines._surface_warp import (
    SurfaceWarp,
    checked_positions,
    checked_task,
    surface_warp,
)
from manireg.manifolds import PointCloud

from .surface_terms import SurfaceTerms
from .wu_kernel import Displacement, centres_around, kernel_matrix

STEPS = 8  # Gauss-Newton steps of a level, at most
HALVINGS = 5
GROWTH = 4.0  # of the surface terms from level to level: first trust the landmarks
RTOL = 1e-3  # relative decrease at which a level ends


def rkhs_warp(
    source_vertices: Numbers,
    source_normals: Numbers,
    source_landmarks: Numbers,
    target_landmarks: Numbers,
    target: PointCloud,
    *,
    levels: int = 4,
    width: float | None = None,
    samples: int = 3000,
    landmark_weight: float = 1e5,
    distance_weight: float = 1e3,
    normal_weight: float = 1e1,
    affine: bool = True,
) -> SurfaceWarp:
    r"""A deformation of space, coarse to fine, that sends landmarks to landmarks and one
    surface to the other: "RKHS warp after [12]", reference 12 of Steinke and Hein 2008.

    $\tau = \tau_L$, $\tau_0$ the affine map of the landmarks, and for each level
    $l = 1 \dots L$ a displacement $u_l(x) = \sum_i \alpha_i k(|x - c_i| / s_l)$ is added,
    $\tau_l = \tau_{l-1} + u_l$, that minimises

    $$\tfrac12 |u_l|_k^2 + C_{lm} \frac1k \sum_i |\tau_l(X_i) - Y_i|^2
      + C_{sd} \sum_j w_j f_T(\tau_l x_j)^2
      + C_n s_l^2 \sum_j w_j |n_T(\tau_l x_j) - n_S(x_j)|^2,$$

    $f_T$ the signed distance to the target, $n = \nabla f$, $\sum w_j = 1$; $C_{sd}$ and
    $C_n$ are those of the last level, a quarter from level to level before.

    From the papers: a deformation of the whole space, smooth in the norm of a
    reproducing kernel space, that makes points go to *similar* ones: of equal signed
    distance and normal, and the landmarks to theirs; no projection at the end; a
    regulariser that does not see distances along the surface; parameters set by hand
    (Schoelkopf, Steinke and Blanz, ICML 2005, of which we had the abstract; Steinke and
    Hein 2008, section 5). Our reconstruction: the kernel (Wu's), the levels, where the
    centres are, the weights and their units, the affine start, samples $x_j$ on the
    surface only, all of the optimisation: Gauss-Newton, with the nearest patches of
    the target renewed before each step.

    **Arguments:**

    - `source_vertices`, `source_normals`: `(n, 3)`, normals on the same side as the
      target's.
    - `source_landmarks`, `target_landmarks`: `(l, 3)`, positions of at least 5 pairs.
    - `target`: a `PointCloud`, e.g. `PointCloud.from_mesh(mesh)`.
    - `levels`, `width`: L, and the first $s_1$, halved from level to level; default: the
      longest side of the target's bounding box. Centres are $s_l / 3$ apart.
    - `samples`: how many x_j, farthest points among the vertices.
    - `landmark_weight`, `distance_weight`, `normal_weight`: $C_{lm}, C_{sd}, C_n$.
      All terms are areas, so these do not depend on the unit of length. The defaults
      are from held-out landmarks of two heads, powers of ten; `held_out_errors`
      tells how well others do.
    - `affine`: False starts from the identity.
    """
    check_x64(target)
    vertices, x, y = checked_task(
        source_vertices, source_landmarks, target_landmarks, target
    )
    normals = _checked_normals(source_normals, vertices)
    options = dict(
        landmark_weight=landmark_weight,
        distance_weight=distance_weight,
        normal_weight=normal_weight,
    )
    for name, value in options.items():
        if not 0 <= value < np.inf:
            raise ValueError(f"{name}: must be 0 or positive, found {value}.")
    for name, value, least in (("levels", levels, 1), ("samples", samples, 10)):
        if value < least:
            raise ValueError(f"{name}: at least {least}, found {value}.")
    if width is None:
        width = float(np.max(np.ptp(np.asarray(target.points), axis=0)))
    if not 0 < width < np.inf:
        raise ValueError(f"width: must be positive and finite, found {width}.")
    matrix, shift = _affine(x, y) if affine else (np.eye(3), np.zeros(3))
    if np.linalg.matrix_rank(matrix, rtol=1e-6) < 3:
        raise ValueError("target_landmarks: all in one plane; affine=False goes there.")
    index = farthest_indices(vertices, min(samples, len(vertices)))
    start = vertices[index] @ matrix.T + shift
    # normals are covectors
    facing = normals[index] @ np.linalg.inv(matrix)
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    surface = SurfaceTerms(
        target, facing, distance_weight / len(index), normal_weight / len(index)
    )
    landmarks = x @ matrix.T + shift
    points = np.concatenate([landmarks, start])
    moved, added = points.copy(), []
    for level in range(levels):
        s = width / 2**level
        centres = centres_around(landmarks, start, s / 3)
        basis = kernel_matrix(points, centres, s)
        gram = kernel_matrix(centres, centres, s)
        share = GROWTH ** (level + 1 - levels)
        alpha = _level(
            gram, basis, moved, y, landmark_weight / len(x), surface, s, share
        )
        moved = moved + basis @ alpha
        added.append((centres, s, alpha))
    return surface_warp(target, Displacement(matrix, shift, added), vertices)


def _level(gram, basis, moved, y, landmark_weight, surface, s, share):
    """alpha of one level, by Gauss-Newton from 0."""
    alpha = np.zeros((gram.shape[1], 3))
    k = len(y)

    def energy(alpha, terms):
        now = moved + basis @ alpha
        norm = 0.5 * np.sum(alpha * (gram @ alpha))
        near = landmark_weight * np.sum((now[:k] - y) ** 2)
        return norm + near + np.sum(terms(now[k:])[0] ** 2)

    for _ in range(STEPS):
        now = moved + basis @ alpha
        terms = surface.terms(now[k:], s, share)  # holds the nearest patches fixed
        residuals, slopes = terms(now[k:], slopes=True)
        # J^T J and J^T r point by point: what they are as functions of tau(x)
        gradient = 2 * np.einsum("jr,jra->ja", residuals, slopes)
        gradient = np.concatenate([2 * landmark_weight * (now[:k] - y), gradient])
        hessian = 2 * np.einsum("jra,jrb->jab", slopes, slopes)
        landmark = np.broadcast_to(2 * landmark_weight * np.eye(3), (k, 3, 3))
        hessian = np.concatenate([landmark, hessian])
        step = -_solve(gram, basis, hessian, gram @ alpha + basis.T @ gradient)
        before, size = energy(alpha, terms), 1.0
        for _ in range(HALVINGS):
            after = energy(alpha + size * step, terms)
            if after <= before:
                break
            size /= 2
        else:
            break
        alpha = alpha + size * step
        if after > (1 - RTOL) * before:
            break
    return alpha


def _solve(gram, basis, hessian, gradient):
    """(I_3 x K + sum_j B_j^T H_j B_j)^{-1} gradient."""
    c = gram.shape[1]
    matrix = np.zeros((3 * c, 3 * c))
    for a in range(3):
        for b in range(a + 1):  # cho_factor reads the lower half
            block = basis.T @ (sp.diags_array(hessian[:, a, b]) @ basis)
            block = block + gram if a == b else block
            matrix[a * c : (a + 1) * c, b * c : (b + 1) * c] = block.toarray()
    matrix[np.diag_indices(3 * c)] += 1e-12 * np.trace(matrix) / (3 * c)
    factor = scipy.linalg.cho_factor(
        matrix, lower=True, overwrite_a=True, check_finite=False
    )
    solution = scipy.linalg.cho_solve(factor, gradient.T.ravel(), check_finite=False)
    return solution.reshape(3, c).T


def _affine(x, y):
    """Least squares."""
    design = np.concatenate([x, np.ones((len(x), 1))], axis=1)
    solution = np.linalg.lstsq(design, y)[0]
    return solution[:3].T, solution[3]


def _checked_normals(normals, vertices) -> np.ndarray:
    normals = checked_positions("source_normals", normals, like=vertices)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    zero = np.flatnonzero(lengths[:, 0] < 1e-12)
    if len(zero):
        raise ValueError(
            f"source_normals: {len(zero)} have no length (first at index {zero[0]})."
        )
    return normals / lengths
