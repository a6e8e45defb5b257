"""Surfaces known by points and normals: scans, meshes."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxkd
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, PRNGKeyArray, ScalarLike
from scipy.spatial import KDTree

from .._numerics import norm_squared
from ._base import AbstractManifold
from ._generic import geodesic_exp
from ._quadric_patch import QuadricPatch


class PointCloud(AbstractManifold):
    r"""A surface in $\mathbb{R}^3$ (or a curve in $\mathbb{R}^2$) given by points and
    normals: near each point it is the `QuadricPatch` fitted to the point's neighbours.

    The patch of $p_i$ is the graph $h(u) = b \cdot u + \tfrac12 u^\top B u$ over the plane
    of the given normal, by least squares with Wendland weights: it goes through $p_i$, and
    its linear term mends normals that are a little off. Neighbours whose normal points to
    the other side (the far side of an ear) are left out.

    **Arguments:**

    - `points`: `(P, s)`, s = 2 or 3, distinct; 30,000 are comfortable.
    - `normals`: `(P, s)`, of any length, all on the same side of the surface.
    - `neighbours`: of each fit, default 12 on surfaces, 6 on curves; 20 to 30 for noisy
      points.
    - `areas`: `(P,)` share of each point in the area, the quadrature weights of a source;
      default: the area of its Voronoi cell in the tangent plane.
    - `search`: `(points, queries) -> index` of the nearest point, `(P, s), (Q, s) ->
      (Q,)`, usable under `jit`. Default: the k-d tree of jaxkd, built once. Measured for
      6,500 queries in 26,000 points: 73 ms; scipy's tree behind a callback takes 28 ms,
      but a callback can lock up a CPU with one thread and cannot run on a GPU.

    Closest points and derivatives are those of the patch of the *nearest point*, so they
    jump (by the error of the fits) where the nearest point changes; `solve` holds the
    patches fixed during a Newton solve and renews them in between. `squared_distance` is
    that of the chord: exact to third order, the fast default near convergence; lengths of
    shortest curves are what `manireg.geodesic` is for.

    **Raises** ValueError for wrong shapes, NaN, repeated points, zero normals, normals
    that change sides along the surface.

    Source: Steinke and Hein 2008, section 4; the linear term is ours.
    """

    points: Float[Array, "P s"]
    normals: Float[Array, "P s"]
    frames: Float[Array, "P s m"]
    slopes: Float[Array, "P m"]
    bendings: Float[Array, "P m m"]
    areas: Float[Array, " P"]
    tree: Any
    search: Callable[[Array, Array], Array] | None = eqx.field(static=True)

    def __init__(
        self,
        points: ArrayLike,
        normals: ArrayLike,
        *,
        neighbours: int | None = None,
        areas: ArrayLike | None = None,
        search: Callable[[Array, Array], Array] | None = None,
    ):
        points, normals = _checked(points, normals)
        s = points.shape[1]
        neighbours = {2: 6, 3: 12}[s] if neighbours is None else neighbours
        least = {2: 3, 3: 6}[s]
        if not least <= neighbours < len(points):
            raise ValueError(
                f"neighbours: must be at least {least} and less than the number of "
                f"points, {len(points)}; found {neighbours}."
            )
        found = KDTree(points).query(points, k=neighbours + 1)
        distance, near = (
            np.asarray(a)[:, 1:] for a in found
        )  # without the point itself
        _check_sides(points, normals, near, distance)
        frames = np.linalg.svd(normals[:, None, :])[2][:, 1:, :].transpose(0, 2, 1)
        slopes, bendings = _fitted(points, normals, frames, near)
        if areas is None:
            areas = _voronoi_areas(points, normals, frames, near, distance)
        self.points, self.normals = jnp.asarray(points), jnp.asarray(normals)
        self.frames = jnp.asarray(frames)
        self.slopes, self.bendings = jnp.asarray(slopes), jnp.asarray(bendings)
        self.areas = jnp.asarray(areas, float)
        self.tree = jaxkd.build_tree(self.points)
        self.search = search

    @classmethod
    def from_mesh(cls, mesh, **options) -> "PointCloud":
        """The vertices of a triangle mesh (`trimesh.Trimesh`) or of a file that trimesh
        loads, with its vertex normals, and a third of the triangles around a vertex as
        its area. Vertices that no triangle uses are dropped, repeated ones merged.

        **Raises** ValueError for an empty mesh, NaN, degenerate triangles only, triangles
        of inconsistent orientation, several components."""
        from ._meshes import mesh_samples

        points, normals, areas = mesh_samples(mesh)
        return cls(points, normals, areas=areas, **options)

    @property
    def dim(self) -> int:
        return self.points.shape[1] - 1

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (self.points.shape[1],)

    @property
    def reach(self) -> ScalarLike:
        """Smallest radius of curvature, but for the sharpest 1 % of the points; thin
        places, where two sides come close, are not looked for."""
        bend = jnp.max(jnp.abs(jnp.linalg.eigvalsh(self.bendings)), axis=1)
        return 1.0 / jnp.percentile(bend, 99.0)

    @property
    def injectivity_radius(self) -> ScalarLike:
        return np.pi * self.reach

    def nearest(self, p: Float[Array, "... s"]) -> Int[Array, "..."]:
        """Index of the nearest point of the cloud."""
        queries = jax.lax.stop_gradient(p.reshape(-1, p.shape[-1]))
        if self.search is not None:
            index = self.search(self.points, queries)
        else:
            index = jaxkd.query_neighbors(self.tree, queries, k=1)[0][:, 0]
        return index.reshape(p.shape[:-1])

    def patches(self, index: Int[Array, "..."]) -> QuadricPatch:
        """The patch of each point of `index`, batched like it."""
        return QuadricPatch(
            self.points[index],
            self.frames[index],
            self.normals[index],
            self.slopes[index],
            self.bendings[index],
        )

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        """Closest point on the patch of the nearest point."""
        return self._on_patches(lambda patch, p: patch.project(p), p)

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return self._on_patches(lambda n, p, v: n.tangent_projection(p, v), p, v)

    def signed_distance(self, p: Float[Array, "... s"]) -> Float[Array, "..."]:
        """Distance to the surface, positive on the side of the normals."""

        def signed(patch, p):
            return (p - patch.project(p)) @ patch.unit_normal(p)

        return self._on_patches(signed, p)

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return self._on_patches(
            lambda n, p, u, v: n.second_fundamental_form(p, u, v), p, u, v
        )

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """Of the chord."""
        return norm_squared(p - q)

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """By integration; it follows the patches, so errors are those of the fits."""
        return geodesic_exp(self, p, v)

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """The projected chord, right to second order, in keeping with
        `squared_distance`."""
        return self.tangent_projection(p, q - p)

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """Points of the cloud, by area, moved by about half a spacing on their patches."""
        choose, move = jax.random.split(key)
        share = self.areas / jnp.sum(self.areas)
        index = jax.random.choice(choose, len(self.points), (n,), p=share)
        spacing = jnp.take(self.areas, index) ** (1 / self.dim)
        u = jax.random.normal(move, (n, self.dim)) * 0.3 * spacing[:, None]
        shift = jnp.einsum("nsm,nm->ns", self.frames[index], u)
        return self.project(self.points[index] + shift)

    def _on_patches(self, function, *arguments):
        s = self.points.shape[1]
        shape = jnp.broadcast_shapes(*(a.shape for a in arguments))
        flat = [jnp.broadcast_to(a, shape).reshape(-1, s) for a in arguments]
        patches = self.patches(self.nearest(flat[0]))
        result = jax.vmap(function)(patches, *flat)
        return result.reshape(*shape[:-1], *result.shape[1:])


def _checked(points, normals) -> tuple[np.ndarray, np.ndarray]:
    points, normals = (np.asarray(a, dtype=float) for a in (points, normals))
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise ValueError(
            f"points: expected shape (P, 3), or (P, 2) for a curve, found {points.shape}."
        )
    if normals.shape != points.shape:
        raise ValueError(
            f"normals: expected shape {points.shape}, one for each point, found "
            f"{normals.shape}."
        )
    for name, values in (("points", points), ("normals", normals)):
        bad = np.flatnonzero(~np.all(np.isfinite(values), axis=1))
        if len(bad):
            raise ValueError(
                f"{name}: {len(bad)} of {len(points)} hold NaN or infinity (first at "
                f"index {bad[0]}); remove these points."
            )
    repeated = len(points) - len(np.unique(points, axis=0))
    if repeated:
        raise ValueError(
            f"points: {repeated} of {len(points)} are repetitions of others; drop them "
            "(numpy.unique), or merge the vertices of the mesh."
        )
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    zero = np.flatnonzero(lengths[:, 0] < 1e-12)
    if len(zero):
        raise ValueError(
            f"normals: {len(zero)} have no length (first at index {zero[0]}); vertices of "
            "degenerate triangles do: remove those."
        )
    return points, normals / lengths


def _check_sides(points, normals, near, distance):
    """Next to each other along the surface, normals have to agree."""
    offset = points[near] - points[:, None]
    along = np.abs(np.einsum("pks,ps->pk", offset, normals)) < 0.2 * distance
    along &= distance < 2 * distance[:, :1]
    opposite = np.einsum("pks,ps->pk", normals[near], normals) < -0.7
    flipped = np.flatnonzero(np.sum(along & opposite, axis=1) >= 2)
    if len(flipped) > max(3, 2e-3 * len(points)):
        raise ValueError(
            f"normals: at {len(flipped)} points (first at index {flipped[0]}) the "
            "neighbours' normals point to the other side of the surface. Orient them "
            "alike, e.g. with trimesh.repair.fix_normals(mesh)."
        )


def _fitted(points, normals, frames, near):
    """Slope and bending of each patch, by weighted least squares."""
    m = frames.shape[2]
    offset = points[near] - points[:, None]
    u = np.einsum("pks,psm->pkm", offset, frames)
    height = np.einsum("pks,ps->pk", offset, normals)
    radius = np.sqrt(np.max(np.sum(u**2, axis=2), axis=1))[:, None]
    u, height = u / radius[:, :, None], height / radius
    r = np.linalg.norm(u, axis=2) / 1.5
    weights = (1 - r) ** 4 * (4 * r + 1)
    weights *= np.einsum("pks,ps->pk", normals[near], normals) > 0
    rows, cols = np.triu_indices(m)
    quadratic = u[:, :, rows] * u[:, :, cols] * np.where(rows == cols, 0.5, 1.0)
    design = np.concatenate([u, quadratic], axis=2)
    weighted = design * weights[:, :, None]
    gram = np.einsum("pki,pkj->pij", weighted, design)
    # where too few neighbours are left the surface is flat
    gram += (
        1e-6 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(len(gram[0]))
    )
    gram += 1e-300 * np.eye(len(gram[0]))
    rhs = np.einsum("pki,pk->pi", weighted, height)[:, :, None]
    solution = np.linalg.solve(gram, rhs)[:, :, 0]
    bending = np.zeros((len(points), m, m))
    bending[:, rows, cols] = bending[:, cols, rows] = solution[:, m:] / radius
    return solution[:, :m], bending


def _voronoi_areas(points, normals, frames, near, distance):
    """Share of a disc around each point, in the tangent plane, that is nearest to it
    rather than to one of its neighbours. The disc reaches just beyond a usual cell, so
    that cells at a boundary end there."""
    m = frames.shape[2]
    side = int(round(1600 ** (1 / m)))
    ticks = (np.arange(side) + 0.5) / side * 2 - 1
    disc = np.stack(np.meshgrid(*[ticks] * m), -1).reshape(-1, m)
    disc = disc[np.sum(disc**2, axis=1) <= 1]
    cell = (2.0 / side) ** m
    ring = {1: 2, 2: 6}[m]
    radius = np.median(distance[:, :ring], axis=1)
    areas = np.zeros(len(points))
    for chunk in np.array_split(np.arange(len(points)), max(1, len(points) // 2000)):
        samples = radius[chunk, None, None] * disc
        offset = points[near[chunk]] - points[chunk, None]
        u = np.einsum("pks,psm->pkm", offset, frames[chunk])
        # |x - u|^2 > |x|^2  <=>  2 x.u < |u|^2
        own = 2 * np.einsum("pdm,pkm->pdk", samples, u) < np.sum(u**2, 2)[:, None]
        same = np.einsum("pks,ps->pk", normals[near[chunk]], normals[chunk]) > 0
        inside = np.sum(np.all(own | ~same[:, None], axis=2), axis=1)
        areas[chunk] = inside * cell * radius[chunk] ** m
    return areas
