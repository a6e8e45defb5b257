"""Does a curve leave a scan across a wall, an edge at which the scan ends?"""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from .facets import Facets

TOUCH = 0.05  # of a wall's length: a curve that is so little beyond it follows it
NARROW = 0.2  # of the width of a gap, where that is less
SHEET = 0.25  # of a wall's length: higher above it is another sheet


class Walls:
    """The walls of `facets` and their frames: along the wall, outwards, across."""

    def __init__(self, facets: Facets):
        points, triangles = facets.points, facets.triangles
        self.facets = facets
        start, end = facets.walls.T
        ends = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        key = lambda pairs: pairs[:, 0] * len(points) + pairs[:, 1]
        order = np.argsort(key(ends), kind="stable")
        of = order[np.searchsorted(key(ends)[order], key(facets.walls))]
        tip = points[triangles[:, [2, 0, 1]].ravel()[of]]
        self.start = points[start]
        self.length = np.linalg.norm(points[end] - points[start], axis=1)
        self.along = (points[end] - points[start]) / self.length[:, None]
        inwards = tip - self.start
        inwards -= np.sum(inwards * self.along, axis=1, keepdims=True) * self.along
        self.outwards = -inwards / np.linalg.norm(inwards, axis=1, keepdims=True)
        self.across = np.cross(self.along, self.outwards)
        self.depth = np.minimum(TOUCH * self.length, NARROW * self._gaps())
        self.tree = KDTree((points[start] + points[end]) / 2)

    def _gaps(self) -> Float[np.ndarray, " W"]:
        """Distance of each wall to the nearest one that faces it."""
        W, places = len(self.length), np.linspace(0.0, 1.0, 5)
        steps = self.length[:, None, None] * places[:, None] * self.along[:, None]
        samples = (self.start[:, None] + steps).reshape(-1, 3)
        of = np.repeat(np.arange(W), len(places))
        distance, other = KDTree(samples).query(samples, k=min(33, len(samples)))
        distance, other = np.asarray(distance)[:, 1:], np.asarray(other)[:, 1:]
        gap = samples[other] - samples[:, None]
        facing = np.einsum("pks,ps->pk", self.outwards[of[other]], self.outwards[of])
        ahead = np.einsum("pks,ps->pk", gap, self.outwards[of]) > 0.5 * distance
        width = np.where((facing < -0.5) & ahead & (distance > 0), distance, np.inf)
        return np.min(width.reshape(W, -1), axis=1)

    def crossed(self, curve: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " w"]:
        """Walls beyond which the curve goes on."""
        where, wall = self._beyond(curve)
        if not len(where):
            return wall
        triangle, closest = self.facets.holding(where)
        normal, gap = self.facets.normals[triangle], where - closest
        height = np.sum(gap * normal, axis=1)
        beside = np.linalg.norm(gap - height[:, None] * normal, axis=1)
        off = beside > 0.5 * self.depth[wall]
        return np.unique(wall[off | (np.abs(height) > SHEET * self.length[wall])])

    def _beyond(self, curve):
        """Places where the curve passes lines a little beyond walls. Next to a corner of
        the wall they may still be on the scan."""
        a, b = curve[:-1], curve[1:]
        chord_length = np.linalg.norm(b - a, axis=1)
        radius = 0.6 * np.max(self.length) + 0.6 * chord_length
        near = self.tree.query_ball_point((a + b) / 2, radius)
        count = np.array([len(found) for found in near])
        chord = np.repeat(np.arange(len(a)), count)
        wall = np.concatenate([np.array(found, int) for found in near])
        from_start = lambda x: x[chord] - self.start[wall]
        dot = lambda x, axis: np.sum(x * axis[wall], axis=1)
        depth = self.depth[wall]
        before, after = (dot(from_start(x), self.outwards) - depth for x in (a, b))
        passes = (before <= 0) != (after <= 0)
        t = before / np.where(passes, before - after, 1.0)
        where = (1 - t)[:, None] * a[chord] + t[:, None] * b[chord]
        offset = where - self.start[wall]
        s, height = dot(offset, self.along), dot(offset, self.across)
        passes &= (s >= -depth) & (s <= self.length[wall] + depth)
        passes &= np.abs(height) <= SHEET * self.length[wall]
        return where[passes], wall[passes]
