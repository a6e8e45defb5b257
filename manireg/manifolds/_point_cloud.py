"""Surfaces known by points and normals: scans, meshes."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxkd
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray, ScalarLike
from scipy.spatial import KDTree

from .._numbers import Numbers
from .._numerics import norm_squared
from .._precision import check_x64
from ._base import AbstractManifold
from ._cloud_fits import (
    check_areas,
    check_sides,
    checked_points,
    fitted_quadrics,
    voronoi_areas,
)
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

    - `points`: `(P, s)`, s = 2 or 3, distinct; 30,000 take a second, 200,000 about
      twenty.
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
        points: Numbers,
        normals: Numbers,
        *,
        neighbours: int | None = None,
        areas: Numbers | None = None,
        search: Callable[[Array, Array], Array] | None = None,
    ):
        check_x64()
        points, normals = checked_points(points, normals)
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
        check_sides(points, normals, near[:, :12], distance[:, :12])
        frames = np.linalg.svd(normals[:, None, :])[2][:, 1:, :].transpose(0, 2, 1)
        slopes, bendings = fitted_quadrics(points, normals, frames, near)
        if areas is None:
            areas = voronoi_areas(points, normals, frames, near, distance)
        check_areas(areas, points)
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

    def padded(self, size: int) -> "PointCloud":
        """The same surface with arrays of `size` points, the last ones out of reach and
        without area: clouds of the same size share compiled programs."""
        more = size - len(self.points)
        if more < 0:
            raise ValueError(f"size: at least {len(self.points)}, found {size}.")
        grown = {}
        for name in ("points", "normals", "frames", "slopes", "bendings", "areas"):
            array = getattr(self, name)
            grown[name] = jnp.concatenate([array, array[:1].repeat(more, 0)])
        extent = jnp.max(jnp.ptp(self.points, axis=0))
        away = 1e3 * extent * (1 + jnp.arange(more) / max(more, 1))
        grown["points"] = grown["points"].at[len(self.points) :].add(away[:, None])
        grown["areas"] = grown["areas"].at[len(self.points) :].set(0.0)
        grown["tree"] = jaxkd.build_tree(grown["points"])
        return eqx.tree_at(
            lambda cloud: tuple(getattr(cloud, name) for name in grown),
            self,
            tuple(grown.values()),
        )

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
        padding = self.areas == 0
        return 1.0 / jnp.nanpercentile(jnp.where(padding, jnp.nan, bend), 99.0)

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
        return _on_patches(self, QuadricPatch.project, p)

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return _on_patches(self, QuadricPatch.tangent_projection, p, v)

    def signed_distance(self, p: Float[Array, "... s"]) -> Float[Array, "..."]:
        """Distance to the surface, positive on the side of the normals."""
        return _on_patches(self, _signed_distance, p)

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return _on_patches(self, QuadricPatch.second_fundamental_form, p, u, v)

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


@eqx.filter_jit
def _on_patches(cloud: PointCloud, function: Callable, *arguments: Array):
    """`function` of the patches of the points nearest to the first of `arguments`;
    compiled once a shape, as its iterations would recompile outside of `jit`."""
    s = cloud.points.shape[1]
    shape = jnp.broadcast_shapes(*(a.shape for a in arguments))
    flat = [jnp.broadcast_to(a, shape).reshape(-1, s) for a in arguments]
    patches = cloud.patches(cloud.nearest(flat[0]))
    result = jax.vmap(function)(patches, *flat)
    return result.reshape(*shape[:-1], *result.shape[1:])


def _signed_distance(patch: QuadricPatch, p):
    return (p - patch.project(p)) @ patch.unit_normal(p)
