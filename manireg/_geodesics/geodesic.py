"""Shortest curves: inputs, starts, and from them the minimum of the harmonic energy."""

import os
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import trimesh

from .._input.numbers import Numbers, as_numbers
from .._input.precision import check_x64
from .._sources.checks import check_points, is_concrete, projected
from ..manifolds import AbstractManifold
from ..manifolds._defaults.logarithm import relaxed_curve
from ..manifolds._scans.surface import Surface, load_surface
from .harmonic import Geodesic, minimise_harmonic
from .on_scans import geodesics_on_scan

RTOL = 1e-14  # predicted relative decrease of the energy at which Newton stops


def geodesic(
    manifold: AbstractManifold | Surface | trimesh.Trimesh | str | os.PathLike,
    p: Numbers,
    q: Numbers,
    *,
    segments: int = 64,
) -> Geodesic:
    r"""The curve from p to q that minimises the harmonic energy

    $$\frac{n}{2} \sum_{i=1}^n |x_i - x_{i-1}|^2, \quad x_i \in N,\; x_0 = p,\; x_n = q,$$

    by Newton's method. The points are right to second order in 1/n. The length is
    $\sum_i \sqrt{|c_i|^2 + |II(c_i, c_i)|^2 / 12}$, the chords $c_i$ corrected for their
    curvature, and right to fourth order: on the unit sphere, for a quarter circle and
    n = 64, to 2e-9.

    The start is the shortest of a few relaxed curves, on a `PointCloud` a shortest path
    along the edges of its mesh or between neighbours. The curve found is a local minimum
    next to it: inside the injectivity radius the shortest curve, beyond it usually (on a
    point cloud another way round may win that is a few percent longer: so are paths in
    the graph).

    Scans have walls: holes, slits and the rim, wherever a mesh has edges with one
    triangle, on points alone gaps of six spacings and more. Where the curve would cross
    one, the shortest path that stays on the scan is the answer, smooth pieces between
    corners of the rim. With triangles it is right to second order in the spacing; points
    alone know a rim to a spacing, and corners are rounded by two. Points beyond the rim
    go to the rim of a mesh.

    **Arguments:**

    - `manifold`: any target; the one with only chords for distances is `PointCloud`. Or a
      scan: a file, a mesh, or what `load_surface` returns.
    - `p`, `q`: points `(..., *manifold.point_shape)`; leading dimensions broadcast.
      With a metric of its own a manifold's `exp` and `log` are taken.
    - `segments`: n >= 2. On a point cloud, steps much shorter than the spacing of the
      points see the jumps between their patches.

    **Returns:** a `Geodesic`: `.points (..., n + 1, *point_shape)`, `.length (...)`,
    `.velocity`, `.converged`.

    Works under `jit` and `vmap`, except on point clouds: their graph is built on the
    host, in each call, so give many pairs at once. For derivatives take
    `manifold.squared_distance`.

    **Raises** ValueError for wrong shapes, NaN, points off the manifold, and for points
    in parts of a cloud that do not hang together.

    Source: Steinke and Hein 2008, section 4 ("an exact, but more expensive method");
    round walls first Lanthier, Maheshwari and Sack, *Approximating shortest paths on
    weighted polyhedral surfaces* (Algorithmica 30, 2001).

    **Example:** a quarter of a great circle, whose length is $\pi / 2$.

    ```python
    north, east = jnp.array([0.0, 0.0, 1.0]), jnp.array([1.0, 0.0, 0.0])
    mr.geodesic(mr.Sphere(2), north, east).length  # 1.5708
    ```
    """
    if isinstance(manifold, Surface | trimesh.Trimesh | str | os.PathLike):
        manifold = load_surface(manifold).cloud
    check_x64(manifold)
    if not isinstance(manifold, AbstractManifold):
        raise ValueError(
            f"manifold: expected a manireg manifold, found {type(manifold).__name__}."
        )
    if not segments >= 2:
        raise ValueError(f"segments: must be at least 2, found {segments}.")
    p, q, batch = _pairs(manifold, p, q)
    if manifold.nearest(p.reshape(len(p), -1)) is not None:
        if not is_concrete(p, q, *jax.tree.leaves(manifold)):
            raise ValueError(
                "p, q: on a PointCloud the neighbour graph is searched on the host; call "
                "`geodesic` outside of jit and vmap, with all pairs in one batch."
            )
        cloud: Any = manifold
        found = geodesics_on_scan(cloud, p, q, segments)
    elif manifold.isometric:
        found = _on_manifold(manifold, p, q, segments)
    else:
        found = _by_logarithm(manifold, p, q, segments)
    return jax.tree.map(lambda a: a.reshape(*batch, *a.shape[1:]), found)


def _pairs(manifold: AbstractManifold, p, q):
    """`p`, `q` as points `(k, *point_shape)` of N, and the shape of the batch."""
    shape = manifold.point_shape
    points = []
    for name, value in (("p", p), ("q", q)):
        value = value if not is_concrete(value) else as_numbers(name, value)
        if value.ndim < len(shape) or value.shape[value.ndim - len(shape) :] != shape:
            expected = ", ".join(map(str, ("...", *shape)))
            raise ValueError(
                f"{name}: expected shape ({expected}) for {type(manifold).__name__}, "
                f"found {value.shape}."
            )
        if is_concrete(value):
            check_points(name, manifold, value.reshape(-1, *shape))
        points.append(jnp.asarray(value, float))
    leading = [a.shape[: a.ndim - len(shape)] for a in points]
    try:
        batch = jnp.broadcast_shapes(*leading)
    except ValueError:
        raise ValueError(
            f"p, q: leading dimensions {leading[0]} and {leading[1]} do not broadcast; "
            "give one q for each p, or a single one."
        ) from None
    p, q = (jnp.broadcast_to(a, (*batch, *shape)).reshape(-1, *shape) for a in points)
    return projected(manifold, p), projected(manifold, q), batch


@eqx.filter_jit
def _on_manifold(manifold: AbstractManifold, p, q, segments: int) -> Geodesic:
    def one(p, q):
        coarse = relaxed_curve(manifold, p, q)
        times = jnp.linspace(0.0, len(coarse) - 1.0, segments + 1)
        interpolate = lambda x: jnp.interp(times, jnp.arange(len(coarse)), x)
        columns = jax.vmap(interpolate, 1, 1)(coarse.reshape(len(coarse), -1))
        return minimise_harmonic(manifold, columns.reshape(-1, *p.shape), RTOL, RTOL)

    return jax.vmap(one)(p, q)


@eqx.filter_jit
def _by_logarithm(manifold: AbstractManifold, p, q, segments: int) -> Geodesic:
    """Where chords do not have the lengths of the manifold."""

    def one(p, q):
        velocity = manifold.log(p, q)
        along = lambda t: manifold.exp(p, t * velocity)
        points = jax.vmap(along)(jnp.linspace(0.0, 1.0, segments + 1))
        length = jnp.sqrt(jnp.sum(manifold.orthonormal(p, velocity) ** 2))
        return Geodesic(points, length, velocity, jnp.all(jnp.isfinite(points)))

    return jax.vmap(one)(p, q)
