"""Surfaces known by points and normals: scans, meshes."""

import warnings
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, PRNGKeyArray, ScalarLike

from ..._algebra.smooth import norm_squared
from ..._input.numbers import Numbers
from ..._input.precision import check_x64
from ..._programs.sizes import filled
from ...meshes._clean import mesh_surface
from .._base import AbstractManifold
from .._defaults.second_form import geodesic_exp
from .closest import nearest_point, on_patches, signed_distance, tree_of
from .cloud_checks import check_one_piece
from .cloud_fits import fitted_cloud, points_in_triangles
from .quadric_patch import QuadricPatch


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
      default: the area of its Voronoi cell in the tangent plane, with `triangles` a
      third of those around it.
    - `triangles`: `(T, 3)` indices of points, where the points are the vertices of a
      mesh. They then say what lies next to each other, so that lips, eyelids and ears,
      whose sides come closer than the points are apart, do not mix.
    - `search`: `(points, queries) -> index` of the nearest point, `(P, s), (Q, s) ->
      (Q,)`, usable under `jit`. Default: the k-d tree of jaxkd, built once. Measured for
      6,500 queries in 26,000 points: 73 ms; scipy's tree behind a callback takes 28 ms,
      but a callback can lock up a CPU with one thread and cannot run on a GPU.

    Closest points and derivatives are those of the patch of the *nearest point*, so they
    jump (by the error of the fits) where the nearest point changes; `solve` holds the
    patches fixed during a Newton solve and renews them in between. `squared_distance` is
    that of the chord: exact to third order, the fast default near convergence; lengths of
    shortest curves are what `manireg.geodesic` is for.

    **Raises** ValueError for wrong shapes, NaN, zero normals, fewer than 7 points (4 on a
    curve); without triangles also for repeated points and normals that change sides along
    the surface.

    Source: Steinke and Hein 2008, section 4; the linear term is ours.

    **Example:** a sphere known by the vertices of a mesh.

    ```python
    cloud = mr.PointCloud.from_mesh(trimesh.creation.icosphere(subdivisions=3))
    cloud.signed_distance(jnp.array([0.0, 0.0, 1.1]))  # 0.10
    ```
    """

    points: Float[Array, "P s"]
    normals: Float[Array, "P s"]
    frames: Float[Array, "P s m"]
    slopes: Float[Array, "P m"]
    bendings: Float[Array, "P m m"]
    areas: Float[Array, " P"]
    tree: tuple[Int[Array, " P"], Int[Array, " P"]]
    """Order of the points in the k-d tree, and the axis each splits."""
    triangles: Int[Array, "T 3"] | None
    of_vertex: Int[Array, " n"] | None
    """For each vertex of the mesh the cloud was made of, its point."""
    search: Callable[[Array, Array], Array] | None = eqx.field(static=True)

    def __init__(
        self,
        points: Numbers,
        normals: Numbers,
        *,
        neighbours: int | None = None,
        areas: Numbers | None = None,
        triangles: ArrayLike | None = None,
        search: Callable[[Array, Array], Array] | None = None,
    ):
        check_x64()
        fits = fitted_cloud(points, normals, neighbours, areas, triangles)
        self.points, self.normals = jnp.asarray(fits.points), jnp.asarray(fits.normals)
        self.frames = jnp.asarray(fits.frames)
        self.slopes, self.bendings = (
            jnp.asarray(fits.slopes),
            jnp.asarray(fits.bendings),
        )
        self.areas = jnp.asarray(fits.areas, float)
        self.tree = tree_of(self.points)
        self.triangles = None if triangles is None else jnp.asarray(fits.triangles)
        self.of_vertex = None
        self.search = search

    @classmethod
    def from_mesh(cls, mesh, **options) -> "PointCloud":
        """The surface of a triangle mesh (`trimesh.Trimesh`) or of a file that trimesh
        loads, repaired as `manireg.load_surface` does. Its points are the vertices, but
        for those that no triangle uses; where triangles end, vertices at one place (at
        seams of a texture) are one point. `.of_vertex` has the point of each vertex, for
        one that no triangle uses the nearest. Normals are means over the angles around a
        point, areas a third of the triangles around it. Options go to `PointCloud`.

        **Warns** (UserWarning) of repairs that may change results: components left out,
        triangles turned, vertices of NaN.
        **Raises** ValueError for an empty mesh, degenerate triangles only, a surface of
        one side only."""
        surface = mesh_surface(mesh)
        if surface.report.notable:
            warnings.warn(f"mesh: {surface.report.notable}.", stacklevel=2)
        cloud = cls(
            surface.points,
            surface.normals,
            **{"areas": surface.areas, "triangles": surface.triangles, **options},
        )
        return eqx.tree_at(
            lambda cloud: cloud.of_vertex,
            cloud,
            jnp.asarray(surface.of_vertex),
            is_leaf=lambda leaf: leaf is None,
        )

    def padded(self, size: int) -> "PointCloud":
        """The same surface with arrays of `size` points, the last ones out of reach and
        without area: clouds of the same size share compiled programs. Triangles are left
        out."""
        more = size - len(self.points)
        if more < 0:
            raise ValueError(f"size: at least {len(self.points)}, found {size}.")
        grown = {}
        for name in ("points", "normals", "frames", "slopes", "bendings", "areas"):
            grown[name] = filled(getattr(self, name), size)
        extent = np.max(np.ptp(np.asarray(self.points), axis=0))
        away = 1e3 * extent * (1 + np.arange(more) / max(more, 1))
        grown["points"][len(self.points) :] += away[:, None]
        grown["areas"][len(self.points) :] = 0.0
        # on the host: each size would be a program of its own
        grown = jax.device_put(grown)
        grown["tree"] = tree_of(grown["points"])
        grown["triangles"] = grown["of_vertex"] = None
        return eqx.tree_at(
            lambda cloud: tuple(getattr(cloud, name) for name in grown),
            self,
            tuple(grown.values()),
            is_leaf=lambda leaf: leaf is None,
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
        return nearest_point(self.points, self.tree, self.search, p)

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
        return on_patches(self, QuadricPatch.project, p)

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return on_patches(self, QuadricPatch.tangent_projection, p, v)

    def signed_distance(self, p: Float[Array, "... s"]) -> Float[Array, "..."]:
        """Distance to the surface, positive on the side of the normals."""
        return on_patches(self, signed_distance, p)

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return on_patches(self, QuadricPatch.second_fundamental_form, p, u, v)

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

    def check_connected(self) -> None:
        check_one_piece(self.triangles, len(self.points))

    def known_points(self, n: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """The points of the cloud and their areas; where a mesh has fewer than `n`
        vertices, points in its triangles, with the same sum of areas."""
        points, areas = np.asarray(self.points), np.asarray(self.areas)
        if n <= len(points) or self.triangles is None:
            return points, areas
        points, shares = points_in_triangles(points[np.asarray(self.triangles)], n)
        return points, shares * np.sum(areas) / np.sum(shares)

    def tolerance(self, points: Float[np.ndarray, "k s"]) -> float:
        """Half a spacing: a cloud is known as well as its points are dense."""
        areas = np.asarray(self.areas)
        return 0.5 * float(np.median(areas[areas > 0])) ** (1 / self.dim)
