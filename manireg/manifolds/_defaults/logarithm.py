"""The logarithm of a manifold that has none in closed form: Newton shooting."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..._algebra.small import eigh
from .._base import AbstractManifold
from .second_form import broadcast_points

_CURVES = 5  # discrete curves, of the shortest of which `shooting_log` starts
_SEGMENTS = 8  # of each of them
_SWEEPS = 30  # of their relaxation; the slowest mode shrinks to 9 %
_SHOTS = 40  # cap on the Newton iterations; 3 to 6 are usual


@eqx.filter_jit
def shooting_log(
    manifold: AbstractManifold, p: Float[Array, "..."], q: Float[Array, "..."]
) -> Float[Array, "..."]:
    r"""The tangent v at p with `manifold.exp(p, v) == q`, by Newton shooting, for a
    manifold without a closed logarithm.

    Starts from the shortest of five discrete curves, relaxed from the chord and bent
    chords by $y_i \leftarrow \pi((y_{i-1} + y_{i+1})/2)$. The geodesic found is the
    shortest one inside the injectivity radius, and usually beyond it. Derivatives of
    all orders exist, also at p == q; p and q are projected first. Uses `project`,
    `tangent_projection` and `exp`.
    """
    p, q = manifold.project(p), manifold.project(q)
    return broadcast_points(eqx.Partial(_shoot, manifold), manifold.point_shape)(p, q)


@eqx.filter_custom_jvp
def _shoot(manifold: AbstractManifold, p: Array, q: Array) -> Array:
    shape, size = p.shape, p.size
    basis = jnp.eye(size).reshape(size, *shape)
    matrix = manifold.tangent_projection(p, basis).reshape(size, size)
    frame = eigh((matrix + matrix.T) / 2)[1][:, size - manifold.dim :]

    def miss(x):
        gap = manifold.exp(p, (frame @ x).reshape(shape)) - q
        return gap.ravel(), gap.ravel()

    def move(state):
        x, best, size, step, damping, _, count = state
        jacobian, gap = jax.jacfwd(miss, has_aux=True)(x + step)
        better = jnp.sum(gap**2) <= size
        gap, jacobian = jax.tree.map(
            lambda new, old: jnp.where(better, new, old), (gap, jacobian), best
        )
        x = jnp.where(better, x + step, x)
        damping = jnp.where(better, 0.0, jnp.maximum(10 * damping, 1e-2))
        normal = jacobian.T @ jacobian + damping * jnp.eye(manifold.dim)
        step = -jnp.linalg.solve(normal, jacobian.T @ gap)
        moving = jnp.sum(step**2) > 1e-26 * jnp.sum(x**2) + rounding
        size = jnp.sum(gap**2)
        return x, (gap, jacobian), size, step, damping, moving, count + 1

    def moving(state):
        *_, moving, count = state
        return moving & (count < _SHOTS)

    rounding = 1e-31 * jnp.sum(p**2 + q**2)
    start = frame.T @ _relaxed_start(manifold, p, q).ravel()
    nothing = (jnp.zeros(size, p.dtype), jnp.zeros((size, manifold.dim), p.dtype))
    far = jnp.array(jnp.inf, p.dtype)
    state = (jnp.zeros_like(start), nothing, far, start, jnp.zeros_like(far), True, 0)
    x, _, _, step, *_ = jax.lax.while_loop(moving, move, state)
    return (frame @ (x + step)).reshape(shape)


@_shoot.def_jvp
def _shoot_jvp(primals, tangents):
    """Differentiates exp(p, P_p v) = q together with P_p v = v; with x in T_pN,
    dv = (D_p P)[dp] v + x and D_v exp x = dq - D_p exp(p, P_p v)[dp]."""
    manifold, p, q = primals
    dmanifold, dp, dq = tangents
    v = _shoot(manifold, p, q)
    shape, size = v.shape, v.size

    def shot(manifold, p, v):
        w = manifold.tangent_projection(p, v)
        return manifold.exp(p, w), w

    def end(v):
        return shot(manifold, p, v)[0]

    basis = jnp.eye(size).reshape(size, *shape)
    tangent = manifold.tangent_projection(p, basis).reshape(size, size)
    jacobian = jax.jacfwd(end)(v).reshape(size, size)
    gap, turn = jnp.zeros_like(v) if dq is None else dq, jnp.zeros_like(v)
    if jax.tree.leaves((dmanifold, dp)):
        moved = (dmanifold, jnp.zeros_like(p) if dp is None else dp, None)
        dend, turn = eqx.filter_jvp(shot, (manifold, p, v), moved)[1]
        gap = gap - dend
    normal = jacobian.T @ jacobian + jnp.eye(size) - tangent
    x = tangent @ jnp.linalg.solve(normal, jacobian.T @ gap.ravel())
    return v, turn + x.reshape(shape)


@eqx.filter_jit
def squared_shooting_distance(
    manifold: AbstractManifold, p: Float[Array, "..."], q: Float[Array, "..."]
) -> Float[Array, "..."]:
    """The squared length of `shooting_log`, of points on the manifold."""
    p, q = jnp.broadcast_arrays(p, q)
    distance = eqx.Partial(_squared_length, manifold)
    for _ in range(p.ndim - len(manifold.point_shape)):
        distance = jax.vmap(distance)
    return distance(p, q)


@eqx.filter_custom_jvp
def _squared_length(manifold: AbstractManifold, p: Array, q: Array) -> Array:
    return jnp.sum(_shoot(manifold, p, q) ** 2)


@_squared_length.def_jvp
def _squared_length_jvp(primals, tangents):
    """The first variation: the gradient at q is -2 log(q, p). One derivative of the
    shooting less."""
    manifold, p, q = primals
    dmanifold, *moves = tangents
    if jax.tree.leaves(dmanifold):
        length = lambda *args: jnp.sum(_shoot(*args) ** 2)
        return eqx.filter_jvp(length, primals, tangents)
    change = jnp.zeros((), p.dtype)
    for here, there, move in ((p, q, moves[0]), (q, p, moves[1])):
        if move is not None:
            change = change - 2 * jnp.sum(_shoot(manifold, here, there) * move)
    return _squared_length(manifold, p, q), change


def relaxed_curve(manifold: AbstractManifold, p: Array, q: Array) -> Array:
    """The shortest `(9, *point_shape)` of a few discrete curves from p to q, relaxed from
    the chord and from bent chords (those pass holes otherwise)."""
    times = jnp.linspace(0.0, 1.0, _SEGMENTS + 1)[1:-1].reshape(-1, *[1] * p.ndim)
    bends = jax.random.normal(jax.random.key(0), (_CURVES, *p.shape), p.dtype)
    bends = bends.at[0].multiply(0.01)  # not 0: symmetry could hold it on a saddle
    bends = 2.0 * jnp.sqrt(jnp.mean((q - p) ** 2)) * bends[:, None]
    inner = p + times * (q - p) + times * (1 - times) * bends
    ends = jnp.broadcast_to(jnp.stack([p, q]), (_CURVES, 2, *p.shape))

    def whole(inner):
        return jnp.concatenate([ends[:, :1], inner, ends[:, 1:]], axis=1)

    def sweep(_, inner):
        curve = whole(inner)
        return manifold.project((curve[:, :-2] + curve[:, 2:]) / 2)

    inner = jax.lax.fori_loop(0, _SWEEPS, sweep, inner)
    curves = whole(inner)
    lengths = jax.vmap(_chord_length)(curves)
    return curves[jnp.nanargmin(lengths)]


def _relaxed_start(manifold: AbstractManifold, p: Array, q: Array) -> Array:
    """First guess of log_p(q): direction and length of a relaxed curve."""
    curve = relaxed_curve(manifold, p, q)
    direction = manifold.tangent_projection(p, curve[1] - curve[0])
    size = jnp.sqrt(jnp.sum(direction**2))
    scale = _chord_length(curve) / jnp.where(size > 0, size, 1.0)
    return direction * jnp.where(size > 0, scale, 0.0)


def _chord_length(curve: Array) -> Array:
    steps = jnp.diff(curve, axis=0).reshape(len(curve) - 1, -1)
    return jnp.sum(jnp.sqrt(jnp.sum(steps**2, axis=1)))
