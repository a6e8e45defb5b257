"""Shortest curves on scans: smooth ones, and round a hole or a slit of the scan smooth
pieces from one corner of its rim to the next."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from ..manifolds import PointCloud
from .around_walls import Path, into_scan, path_around_walls
from .facets import Facets, facets
from .harmonic import Geodesic, minimise_harmonic
from .scan_graph import equal_steps, paths, scan_graph
from .walls import Walls

RTOL = 1e-8  # predicted relative decrease of the energy at which Newton stops
NOISE = 1e-4  # steps that promise less than this may fail: patches jump
ROOM = 5  # spacings around a curve on a cloud, in which walls are looked for
DEEPEST = 12  # corners in a row that a path may have missed
SHORT = 4  # pieces shorter than a curve by this factor have fewer steps by it


class _Curve(NamedTuple):
    """A `Geodesic`, on the host."""

    points: Float[np.ndarray, "n s"]
    length: float
    velocity: Float[np.ndarray, " s"]
    converged: bool


def geodesics_on_scan(cloud: PointCloud, p, q, segments: int) -> Geodesic:
    """`p`, `q`: k points of the cloud; those beyond its rim go to the rim."""
    p, q, graph = np.array(p), np.array(q), scan_graph(cloud)
    points = np.asarray(cloud.points)
    scan = None if cloud.triangles is None else facets(cloud)
    if scan is not None and len(scan.walls):
        (p, first), (q, last) = (_onto(scan, x) for x in (p, q))
    else:
        first, last = (np.asarray(cloud.nearest(jnp.asarray(x))) for x in (p, q))
    curves = [
        # p and q take the place of the points next to them
        _smooth(cloud, np.stack([start, *points[path[1:-1]], end]), segments)
        for start, end, path in zip(p, q, paths(graph, first, last), strict=True)
    ]
    if scan is None and cloud.dim == 2:
        scan = facets(cloud, _near(cloud, curves))
    if scan is not None and len(scan.walls):
        walls = Walls(scan)
        for i, curve in enumerate(curves):
            if len(walls.crossed(curve.points)):
                path = path_around_walls(cloud, graph, p[i], q[i], first[i], last[i])
                curves[i] = _around(cloud, walls, curve, path, segments)
    return Geodesic(*(jnp.asarray(np.stack(a)) for a in zip(*curves, strict=True)))


def _smooth(cloud: PointCloud, corners, segments: int) -> _Curve:
    found = _minimised(cloud, jnp.asarray(equal_steps(corners, segments)))
    points, velocity = np.asarray(found.points), np.asarray(found.velocity)
    return _Curve(points, float(found.length), velocity, bool(found.converged))


@eqx.filter_jit
def _minimised(cloud: PointCloud, start: Float[Array, "points s"]) -> Geodesic:
    return minimise_harmonic(cloud, start, RTOL, NOISE)


def _onto(
    mesh: Facets, x: Float[np.ndarray, "k 3"]
) -> tuple[Float[np.ndarray, "k 3"], Int[np.ndarray, " k"]]:
    """Points, those beside the triangles on the rim, and the nearest corner of each."""
    triangle, closest = mesh.holding(x)
    gap, normal = x - closest, mesh.normals[triangle]
    beside = np.linalg.norm(
        gap - np.sum(gap * normal, 1, keepdims=True) * normal, axis=1
    )
    x = np.where((beside > 1e-9 * mesh.sizes[triangle])[:, None], closest, x)
    corners = mesh.triangles[triangle]
    distance = np.linalg.norm(mesh.points[corners] - x[:, None], axis=2)
    return x, corners[np.arange(len(x)), np.argmin(distance, axis=1)]


def _near(cloud: PointCloud, curves: list[_Curve]):
    """Points of the cloud around curves."""
    points = np.asarray(cloud.points)
    near = np.zeros(len(points), bool)
    for curve in curves:
        step = np.max(np.linalg.norm(np.diff(curve.points, axis=0), axis=1))
        room = 2 * ROOM * cloud.tolerance(points) + step
        near |= KDTree(curve.points).query(points, distance_upper_bound=room)[0] < room
    return near


def _around(
    cloud: PointCloud, walls: Walls, curve: _Curve, path: Path | None, segments: int
) -> _Curve:
    """Smooth pieces between the corners of a path."""
    if path is None:  # a cloud too sparse for triangles
        return curve._replace(converged=False)
    cuts = np.concatenate([[0], np.flatnonzero(path.corner), [len(path.points) - 1]])
    whole, pieces = _length(path.points), []
    for a, b in zip(cuts[:-1], cuts[1:], strict=True):
        pieces += _taut(cloud, walls, path.points[a : b + 1], whole, segments)
    corners = [pieces[0].points[:1], *(piece.points[1:] for piece in pieces)]
    points = equal_steps(np.concatenate(corners), segments)
    points[1:-1] = np.asarray(cloud.project(jnp.asarray(points[1:-1])))
    length = sum(piece.length for piece in pieces)
    start, ahead = jnp.asarray(points[0]), jnp.asarray(pieces[0].velocity)
    velocity = np.asarray(cloud.tangent_projection(start, ahead))
    velocity = velocity * (length / max(np.linalg.norm(velocity), 1e-300))
    return _Curve(points, length, velocity, all(piece.converged for piece in pieces))


def _taut(
    cloud: PointCloud, walls: Walls, piece, whole: float, segments: int, depth: int = 0
) -> list[_Curve]:
    """Smooth along a piece of a path; where that leaves the scan, by way of the corner
    most in its way. Pieces in one triangle are straight."""
    length = _length(piece)
    straight = _Curve(piece, length, piece[1] - piece[0], len(piece) == 2)
    if len(piece) == 2:
        return [straight]
    few = max(2, segments // SHORT)
    smooth = _smooth(cloud, piece, few if SHORT * length < whole else segments)
    crossed = walls.crossed(smooth.points)
    if not len(crossed):
        return [smooth]
    corner = _in_the_way(walls, crossed, smooth.points)
    if corner is None or depth == DEEPEST:
        return [straight]
    at = 1 + np.argmin(np.linalg.norm(piece[1:-1] - corner, axis=1))
    return [
        smaller
        for part in ([*piece[:at], corner], [corner, *piece[at + 1 :]])
        for smaller in _taut(cloud, walls, np.array(part), whole, segments, depth + 1)
    ]


def _in_the_way(walls: Walls, crossed, curve):
    """Of the ends of the walls crossed the one that is farthest inside the scan."""
    ends = np.unique(walls.facets.walls[crossed])
    corners = walls.facets.points[ends]
    gaps = corners[:, None] - curve
    nearest = np.argmin(np.sum(gaps**2, axis=2), axis=1)
    inside = [
        gaps[i, nearest[i]] @ into_scan(walls.facets, end) for i, end in enumerate(ends)
    ]
    best = int(np.argmax(inside))
    return corners[best] if inside[best] > 0 else None


def _length(corners) -> float:
    return float(np.sum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
