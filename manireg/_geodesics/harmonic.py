"""A discrete curve from a start to the nearest minimum of its harmonic energy.

The points of the curve move in their tangent planes and are projected back. In tangent
coordinates the Hessian of the energy needs the second fundamental form only, since
pi(x + v) = x + v + II(v, v)/2 + ..: no automatic differentiation.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._algebra.banded import solve_banded
from .._algebra.smooth import norm_squared
from ..manifolds import AbstractManifold
from ..manifolds._defaults.frames import frames_at

STEP_SIZES = (1.0, 0.5, 0.2, 0.05, 0.01)  # of Newton steps, tried at once
MAX_STEPS = 50


class Geodesic(eqx.Module):
    """A curve, or a batch of curves, of equal steps from p to q."""

    points: Float[Array, "..."]
    """`(..., n + 1, *point_shape)`; the first is p, the last q (projected)."""
    length: Float[Array, "..."]
    velocity: Float[Array, "..."]
    r"""$\log_p q$, `(..., *point_shape)`: tangent at p, as long as the curve."""
    converged: Bool[Array, "..."]
    """Whether Newton's method ended at a critical point, on a curve without a gap."""


def minimise_harmonic(
    manifold: AbstractManifold,
    curve: Float[Array, "points ..."],
    rtol: float,
    noise: float,
) -> Geodesic:
    """Newton's method with both ends held, until a step promises a relative decrease of
    less than `rtol`, or one that promises less than `noise` fails. On a point cloud the
    patches are fixed during a step; those of its result are the nearest ones there."""

    def move(state):
        curve, patches, energy, _, _, count = state
        step, decrease = _newton_step(manifold, patches, curve)
        moved = (curve[1:-1] + sizes * step).reshape(-1, *curve.shape[1:])
        renewed = _nearest(manifold, moved)
        inner = _pointwise(manifold, renewed, lambda near, x: near.project(x), moved)
        tries = jnp.broadcast_to(curve[None], (len(STEP_SIZES), *curve.shape))
        tries = tries.at[:, 1:-1].set(inner.reshape(tries[:, 1:-1].shape))
        energies = jax.vmap(_energy)(tries)
        # far from the origin energies are known to the rounding of the points
        blur = 4 * jnp.finfo(float).eps * jnp.max(jnp.abs(curve))
        unknown = 1e-14 * energy + blur * jnp.sqrt(2 * energy * (len(curve) - 1))
        best = jnp.nanargmin(energies.at[0].add(-unknown))  # full if all tie
        lower = energies[best] <= energy + unknown
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


def _nearest(manifold: AbstractManifold, points):
    """Which patches of a point cloud are N near these points; other manifolds have one."""
    nearest = manifold.nearest(points.reshape(len(points), -1))
    return jnp.zeros(len(points), int) if nearest is None else nearest


def _pointwise(manifold: AbstractManifold, patches, function, *arguments):
    """`function(N, x, ..)` at each point; on a point cloud N is a patch of `patches`."""
    near = manifold.patches(patches)
    axis = None if near is manifold else eqx.if_array(0)
    axes = (axis, *(0 for _ in arguments))
    return eqx.filter_vmap(function, in_axes=axes)(near, *arguments)


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
    below = jnp.pad(jnp.swapaxes(side, 1, 2), ((0, 1), (0, 0), (0, 0)))
    solve = lambda own: solve_banded(jnp.stack([own, below], 1), gradient[:, None])
    x, of_model = (x[:, 0] for x in jax.vmap(solve)(jnp.stack([model + bend, model])))
    x = jnp.where(jnp.all(jnp.isfinite(x)), x, of_model)
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
