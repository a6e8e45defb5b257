"""From a registration to its certificate."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from .._solver.at_minimum import at_minimum
from .._solver.diagnostics import Diagnostics, diagnostics
from .._solver.model import RegressionMap
from ..manifolds import PointCloud
from ..manifolds._scans.surface import Surface
from .certificate import Certificate
from .folds import agreement
from .mesh_distance import mesh_distance

# 95 % quantile of true errors over semi-axes, faces 1 to 7 of SIMPOP
OF_MATCHES = 4.1
CHUNK = 8192  # vertices at a time, whose covariances are in memory


def certificate_of(
    model: RegressionMap,
    vertices: Float[np.ndarray, "n 3"],
    source: Surface,
    target: Surface,
    landmarks: int,
    match_weights: Float[np.ndarray, " n"] | None,
    back: RegressionMap | None,
) -> Certificate:
    """Of a map that sends the vertices of the source to `vertices`; `back` goes from the
    target to the source."""
    cloud, onto = source.cloud, target.cloud
    at_vertices = lambda values: np.asarray(values)[source.of_vertex]
    matched = inverse = None
    if match_weights is not None:
        areas = np.asarray(cloud.areas)[source.of_vertex]
        matched = float(np.average(match_weights, weights=areas))
    if back is not None:
        points = np.asarray(cloud.points)
        inverse = np.linalg.norm(_there_and_back(model, back, points) - points, axis=1)
        inverse = at_vertices(inverse)
    turned = None
    if source.faces is not None:
        turned = agreement(vertices, source.faces, onto)
    seen = _diagnostics(model)
    radius = _radii(model, cloud, seen, match_weights is not None)
    from_target = np.full(len(target.places), np.nan)
    used = slice(None) if target.faces is None else np.unique(target.faces)
    from_target[used] = _distances(target.places[used], vertices, source.faces, None)
    return Certificate(
        agreement=turned,
        stretches=at_vertices(_stretches(model, cloud)),
        radius95=None if radius is None else at_vertices(radius),
        to_target=_distances(vertices, target.places, target.faces, onto),
        from_target=from_target,
        inverse_error=inverse,
        left_out=_left_out(seen, model, landmarks),
        matched=matched,
        vertices=vertices,
    )


def _stretches(model: RegressionMap, cloud: PointCloud) -> Float[np.ndarray, "P 2"]:
    found = model.differential(cloud.points)
    by_axes = jnp.einsum("pta,psa->pts", found.derivatives, found.frame)
    along = jnp.einsum("pts,psm->ptm", by_axes, cloud.frames)
    return np.linalg.svd(np.asarray(along), compute_uv=False)


def _radii(
    model: RegressionMap,
    cloud: PointCloud,
    missed: Diagnostics | None,
    of_matches: bool,
) -> Float[np.ndarray, " P"] | None:
    if missed is None:
        return None
    posterior, points = model.posterior("known"), np.asarray(cloud.points)
    parts = np.array_split(points, -(-len(points) // CHUNK))
    radii = [posterior.region(x).semi_axes[:, -1] for x in parts]
    if of_matches:
        return OF_MATCHES * np.concatenate(radii)
    squares = missed.standardised**2 / cloud.dim
    squares = squares[np.isfinite(squares)]
    scale = np.sqrt(squares.mean()) if len(squares) else 1.0
    return scale * np.concatenate(radii)


def _diagnostics(model: RegressionMap) -> Diagnostics | None:
    if model.problem is None:
        return None
    found = at_minimum(model)
    return diagnostics(model.problem, found, float(np.sqrt(found.spread.variance)))


def _left_out(seen: Diagnostics | None, model: RegressionMap, landmarks: int):
    if seen is None or model.problem is None or len(model.problem.y) != landmarks:
        return None
    missed = np.full(landmarks, np.nan)
    missed[seen.data] = seen.left_out
    return missed


def _there_and_back(model: RegressionMap, back: RegressionMap, points):
    return np.asarray(back(model(jnp.asarray(points))))


def _distances(x, vertices, faces, cloud: PointCloud | None):
    if faces is not None:
        return mesh_distance(x, vertices, faces)
    if cloud is not None:
        return np.linalg.norm(np.asarray(cloud.project(jnp.asarray(x))) - x, axis=1)
    return KDTree(vertices).query(x)[0]
