"""Shortest curves, by minimising the harmonic energy of a discrete curve.

The points of the curve move in their tangent planes and are projected back. In tangent
coordinates the Hessian of the energy needs the second fundamental form only, since
pi(x + v) = x + v + II(v, v)/2 + ..: no automatic differentiation.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from ._block_tridiagonal import solve_tridiagonal
from ._checks import check_points, check_x64, is_concrete, projected
from ._cloud_paths import cloud_paths
from ._frames import frames_at
from ._numerics import norm_squared
from .manifolds import AbstractManifold, PointCloud
from .manifolds._shooting import relaxed_curve

STEP_SIZES = (1.0, 0.5, 0.2, 0.05, 0.01)  # of Newton steps, tried at once
MAX_STEPS = 50
RTOL = 1e-14  # predicted relative decrease of the energy at which Newton stops
CLOUD_RTOL = 1e-8  # the same on a point cloud,
CLOUD_NOISE = 1e-4  # where steps that promise less than this may fail: patches jump


class Geodesic(eqx.Module):
    """A curve, or a batch of curves, of equal steps from p to q."""

    points: Float[Array, "..."]
    """`(..., n + 1, *point_shape)`; the first is p, the last q (projected)."""
    length: Float[Array, "..."]
    velocity: Float[Array, "..."]
    r"""$\log_p q$, `(..., *point_shape)`: tangent at p, as long as the curve."""
    converged: Bool[Array, "..."]
    """Whether Newton's method ended at a critical point, on a curve without a gap."""


def geodesic(
    manifold: AbstractManifold,
    p: ArrayLike,
    q: ArrayLike,
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
    in the graph of neighbours. The curve found is a local minimum next to it: inside the
    injectivity radius the shortest curve, beyond it usually (on a point cloud another way
    round may win that is a few percent longer: so are paths in the graph).

    **Arguments:**

    - `manifold`: any target; the one with only chords for distances is `PointCloud`.
    - `p`, `q`: points `(..., *manifold.point_shape)`; leading dimensions broadcast.
    - `segments`: n >= 2. On a point cloud, steps much shorter than the spacing of the
      points see the jumps between their patches.

    **Returns:** a `Geodesic`: `.points (..., n + 1, *point_shape)`, `.length (...)`,
    `.velocity`, `.converged`.

    Works under `jit` and `vmap`, except on point clouds: their graph is built on the
    host, in each call, so give many pairs at once. For derivatives take
    `manifold.squared_distance`.

    **Raises** ValueError for wrong shapes, NaN, points off the manifold, and for points
    in parts of a cloud that do not hang together.

    Source: Steinke and Hein 2008, section 4 ("an exact, but more expensive method").
    """
    check_x64()
    if not isinstance(manifold, AbstractManifold):
        raise ValueError(
            f"manifold: expected a manireg manifold, found {type(manifold).__name__}."
        )
    if not segments >= 2:
        raise ValueError(f"segments: must be at least 2, found {segments}.")
    p, q, batch = _pairs(manifold, p, q)
    if isinstance(manifold, PointCloud):
        if not is_concrete(p, q, manifold.points):
            raise ValueError(
                "p, q: on a PointCloud the neighbour graph is searched on the host; call "
                "`geodesic` outside of jit and vmap, with all pairs in one batch."
            )
        starts = jnp.asarray(cloud_paths(manifold, p, q, segments))
        found = _on_cloud(manifold, starts)
    else:
        found = _on_manifold(manifold, p, q, segments)
    return jax.tree.map(lambda a: a.reshape(*batch, *a.shape[1:]), found)


def _pairs(manifold: AbstractManifold, p, q):
    """`p`, `q` as points `(k, *point_shape)` of N, and the shape of the batch."""
    shape = manifold.point_shape
    points = []
    for name, value in (("p", p), ("q", q)):
        value = value if not is_concrete(value) else np.asarray(value)
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
        return _newton(manifold, columns.reshape(-1, *p.shape), RTOL, RTOL)

    return jax.vmap(one)(p, q)


@eqx.filter_jit
def _on_cloud(cloud: PointCloud, starts: Float[Array, "k points s"]) -> Geodesic:
    def one(start):
        return _newton(cloud, start, CLOUD_RTOL, CLOUD_NOISE)

    return jax.lax.map(one, starts)


def _nearest(manifold: AbstractManifold, points):
    """Which patches of a point cloud are N near these points; other manifolds have one."""
    if isinstance(manifold, PointCloud):
        return manifold.nearest(points)
    return jnp.zeros(len(points), int)


def _pointwise(manifold: AbstractManifold, patches, function, *arguments):
    """`function(N, x, ..)` at each point; on a point cloud N is a patch of `patches`."""
    near, axis = manifold, None
    if isinstance(manifold, PointCloud):
        near, axis = manifold.patches(patches), eqx.if_array(0)
    axes = (axis, *(0 for _ in arguments))
    return eqx.filter_vmap(function, in_axes=axes)(near, *arguments)


def _newton(manifold: AbstractManifold, curve, rtol: float, noise: float) -> Geodesic:
    """From a start to a minimiser. On a point cloud the patches are held fixed during a
    step; those of its result are the nearest ones there."""

    def move(state):
        curve, patches, energy, _, _, count = state
        step, decrease = _newton_step(manifold, patches, curve)
        moved = (curve[1:-1] + sizes * step).reshape(-1, *curve.shape[1:])
        renewed = _nearest(manifold, moved)
        inner = _pointwise(manifold, renewed, lambda near, x: near.project(x), moved)
        tries = jnp.broadcast_to(curve[None], (len(STEP_SIZES), *curve.shape))
        tries = tries.at[:, 1:-1].set(inner.reshape(tries[:, 1:-1].shape))
        energies = jax.vmap(_energy)(tries)
        best = jnp.nanargmin(energies.at[0].multiply(1 - 1e-14))  # full if all tie
        lower = energies[best] <= energy * (1 + 1e-14)
        rounding = 1e-30 * jnp.sum(curve**2)
        done = (decrease <= rtol * energy + rounding) | (
            ~lower & (decrease <= noise * energy)
        )
        new = (tries[best], renewed.reshape(len(STEP_SIZES), -1)[best], energies[best])
        old = (curve, patches, energy)
        kept = jax.tree.map(lambda a, b: jnp.where(lower, a, b), new, old)
        return *kept, done, lower, count + 1

    def moving(state):
        *_, done, lower, count = state
        return ~done & lower & (count < MAX_STEPS)

    sizes = jnp.array(STEP_SIZES).reshape(-1, *[1] * curve.ndim)
    patches = _nearest(manifold, curve[1:-1])
    inner = _pointwise(manifold, patches, lambda near, x: near.project(x), curve[1:-1])
    curve = curve.at[1:-1].set(inner)
    state = (curve, patches, _energy(curve), jnp.array(False), jnp.array(True), 0)
    curve, patches, _, done, *_ = jax.lax.while_loop(moving, move, state)
    return _measured(manifold, patches, curve, done)


def _energy(curve):
    return 0.5 * jnp.sum(jnp.diff(curve, axis=0) ** 2)


def _newton_step(manifold: AbstractManifold, patches, curve):
    """Tangent vectors at the inner points, and the decrease of the energy they promise:
    with the exact Hessian where it is positive definite, else without the curvature of
    N, which is the Gauss-Newton model."""

    def local(near, x, pull):
        frame = frames_at(near, x[None])[0]
        vectors = frame.T.reshape(-1, *x.shape)
        form = near.second_fundamental_form(x, vectors[:, None], vectors[None])
        bend = form.reshape(*form.shape[:2], -1) @ pull.ravel()
        return frame, frame.T @ pull.ravel(), bend

    inner = curve[1:-1]
    pull = 2 * inner - curve[:-2] - curve[2:]
    frames, gradient, bend = _pointwise(manifold, patches, local, inner, pull)
    side = -jnp.einsum("ita,itb->iab", frames[:-1], frames[1:])
    model = 2 * jnp.broadcast_to(jnp.eye(manifold.dim), bend.shape)
    solve = jax.vmap(solve_tridiagonal, (0, None, None))
    x, positive = solve(jnp.stack([model + bend, model]), side, gradient)
    x = jnp.where(positive[0], *x)
    step = -jnp.einsum("itm,im->it", frames, x).reshape(inner.shape)
    return step, 0.5 * jnp.sum(x * gradient)


def _measured(manifold: AbstractManifold, patches, curve, done) -> Geodesic:
    """An arc of curvature k over the chord c is sqrt(c^2 + k^2 c^4 / 12) long, to fourth
    order, and k c^2 = |II(c, c)|."""

    def bend(near, x, chord):
        x = near.project(x)
        along = near.tangent_projection(x, chord)
        return near.second_fundamental_form(x, along, along)

    chords, axes = jnp.diff(curve, axis=0), curve.ndim - 1
    middle = (curve[1:] + curve[:-1]) / 2
    patches = jnp.append(patches, patches[-1])
    form = _pointwise(manifold, patches, bend, middle, chords)
    lengths = jnp.sqrt(norm_squared(chords, axes) + norm_squared(form, axes) / 12)
    length = jnp.sum(lengths)
    start = manifold.tangent_projection(curve[0], chords[0])
    size = jnp.sqrt(jnp.sum(start**2))
    velocity = start * jnp.where(size > 0, length / jnp.where(size > 0, size, 1.0), 0.0)
    # steps are equal, but for a gap
    rounding = 1e-14 * jnp.max(jnp.abs(curve))
    whole = jnp.max(lengths) <= 2 * jnp.mean(lengths) + rounding
    return Geodesic(curve, length, velocity, done & whole)
