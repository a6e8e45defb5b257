"""What a manifold can leave to automatic differentiation.

With a closest point projection alone, `second_form_of_projection`, `geodesic_exp` and
`shooting_log` supply the rest. `implicit_solution` and `implicit_projection` give an
iterative solver derivatives of all orders, without differentiating the iteration.
The functions with loops are jitted, so that calls outside of `jit` compile them once.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._base import AbstractManifold

_CURVES = 5  # discrete curves, of the shortest of which `shooting_log` starts
_SEGMENTS = 8  # of each of them
_SWEEPS = 30  # of their relaxation; the slowest mode shrinks to 9 %
_SHOTS = 40  # cap on the Newton iterations; 3 to 6 are usual


def _cooper_verner() -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (11, 11), strictly lower triangular, and weights (11,)."""
    s = np.sqrt(21.0)
    rows = [
        [],
        [1 / 2],
        [1 / 4, 1 / 4],
        [1 / 7, (-7 - 3 * s) / 98, (21 + 5 * s) / 49],
        [(11 + s) / 84, 0, (18 + 4 * s) / 63, (21 - s) / 252],
        [(5 + s) / 48, 0, (9 + s) / 36, (14 * s - 231) / 360, (63 - 7 * s) / 80],
        [(10 - s) / 42, 0, (92 * s - 432) / 315, (633 - 145 * s) / 90]
        + [(115 * s - 504) / 70, (63 - 13 * s) / 35],
        [1 / 14, 0, 0, 0, (14 - 3 * s) / 126, (13 - 3 * s) / 63, 1 / 9],
        [1 / 32, 0, 0, 0, (91 - 21 * s) / 576, 11 / 72, (-385 - 75 * s) / 1152]
        + [(63 + 13 * s) / 128],
        [1 / 14, 0, 0, 0, 1 / 9, (-733 - 147 * s) / 2205, (515 + 111 * s) / 504]
        + [(-51 - 11 * s) / 56, (132 + 28 * s) / 245],
        [0, 0, 0, 0, (7 * s - 42) / 18, (28 * s - 18) / 45, (-273 - 53 * s) / 72]
        + [(301 + 53 * s) / 72, (28 - 28 * s) / 45, (49 - 7 * s) / 18],
    ]
    weights = [1 / 20, 0, 0, 0, 0, 0, 0, 49 / 180, 16 / 45, 49 / 180, 1 / 20]
    stages = np.array([row + [0.0] * (11 - len(row)) for row in rows])
    return stages, np.array(weights)


_STAGES, _WEIGHTS = _cooper_verner()


def broadcast_points(
    function: Callable[..., Array], point_shape: tuple[int, ...]
) -> Callable[..., Array]:
    """Turns a function of single points, `point_shape` each, into one of broadcasting
    batches `(..., *point_shape)`. The result is a single point too."""
    point = "(" + ",".join(f"d{i}" for i in range(len(point_shape))) + ")"

    def batched(*points: Float[Array, "..."]) -> Float[Array, "..."]:
        signature = ",".join([point] * len(points)) + "->" + point
        return jnp.vectorize(function, signature=signature)(*points)

    return batched


def second_form_of_projection(
    project: Callable[[Array], Array],
    p: Float[Array, "..."],
    u: Float[Array, "..."],
    v: Float[Array, "..."],
) -> Float[Array, "..."]:
    r"""$II_p(u, v) = D^2\pi(p)[u, v]$ for p on N and tangent u, v, in any codimension.

    **Arguments:** `project` the closest point projection, broadcasting; `p`, `u`,
    `v` of shape `(..., *point_shape)`.
    """
    p, u, v = jnp.broadcast_arrays(p, u, v)

    def along_u(x):
        return jax.jvp(project, (x,), (u,))[1]

    return jax.jvp(along_u, (p,), (v,))[1]


@eqx.filter_jit
def geodesic_exp(
    manifold: AbstractManifold,
    p: Float[Array, "..."],
    v: Float[Array, "..."],
    steps: int = 24,
) -> Float[Array, "..."]:
    r"""End point at time 1 of $y'' = II_y(y', y')$, $y(0) = p$, $y'(0) = v$, by the
    Runge-Kutta method of order 8 of Cooper and Verner (1972).

    The drift off N is of the order of the integration error, so the projection is left
    to the end. Uses `second_fundamental_form` (at points and for vectors that are off N
    by that much) and `project`.

    **Arguments:** `steps` number of equal steps. On the torus of radii 2 and 1 the
    default errs by 3e-15, 2e-10 and 5e-7 for |v| = 1, 3 and 6.
    """
    initial = jnp.stack(jnp.broadcast_arrays(p, v))
    h = 1.0 / steps

    # A loop over the stages, too: it compiles one second fundamental form, not eleven.
    def stage(state, row):
        start, slopes = state
        i, coefficients = row
        y, w = start + h * jnp.tensordot(coefficients, slopes, 1)
        slope = jnp.stack([w, manifold.second_fundamental_form(y, w, w)])
        return (start, slopes.at[i].set(slope)), None

    def step(start, _):
        slopes = jnp.zeros((len(_WEIGHTS), *start.shape), start.dtype)
        (_, slopes), _ = jax.lax.scan(stage, (start, slopes), rows)
        return start + h * jnp.tensordot(weights, slopes, 1), None

    rows = (jnp.arange(len(_WEIGHTS)), jnp.asarray(_STAGES, initial.dtype))
    weights = jnp.asarray(_WEIGHTS, initial.dtype)
    (y, _), _ = jax.lax.scan(step, initial, None, length=steps)
    return manifold.project(y)


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
    frame = jnp.linalg.eigh((matrix + matrix.T) / 2)[1][:, size - manifold.dim :]

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


def implicit_solution(
    iterate: Callable[..., Array], residual: Callable[..., Array], *arguments: Any
) -> Float[Array, " x"]:
    r"""`x = iterate(*arguments)`, a vector with `residual(x, *arguments) == 0`, made
    differentiable in `arguments` to all orders:
    $dx = -(\partial_x r)^{-1}\, \partial_{arguments} r$.

    Neither function may close over traced values: pass them in `arguments`, as pytrees.
    """
    return _solution(iterate, residual, arguments)


@eqx.filter_custom_jvp
def _solution(iterate, residual, arguments):
    return iterate(*arguments)


@_solution.def_jvp
def _solution_jvp(primals, tangents):
    iterate, residual, arguments = primals
    _, dresidual, darguments = tangents
    x = _solution(iterate, residual, arguments)  # again: its own derivatives follow

    def at_x(residual, arguments):
        return residual(x, *arguments)

    dr = eqx.filter_jvp(at_x, (residual, arguments), (dresidual, darguments))[1]
    jacobian = jax.jacfwd(lambda x: residual(x, *arguments))(x)
    return x, -jnp.linalg.solve(jacobian, dr)


def implicit_projection(
    manifold: AbstractManifold,
    p: Float[Array, "..."],
    *,
    closest_point: Callable[..., Array],
    tangent_projection: Callable[..., Array],
    second_fundamental_form: Callable[..., Array],
) -> Float[Array, "..."]:
    r"""Closest point y of p by any iteration, with derivatives of all orders in p:
    $dy = (I - A_{p-y})^{-1} P_y\, dp$, where $\langle A_\nu u, v \rangle =
    \langle II_y(u, v), \nu \rangle$.

    **Arguments:** three functions of the manifold and of single points:
    `closest_point(manifold, p)`, never differentiated; `tangent_projection(manifold, y,
    v)` and `second_fundamental_form(manifold, y, u, v)`, needed on N only. Fields of
    the manifold get no derivatives (asking for them raises): `implicit_solution` can.
    """
    closest = eqx.Partial(
        _closest, closest_point, tangent_projection, second_fundamental_form, manifold
    )
    return broadcast_points(closest, manifold.point_shape)(p)


@eqx.filter_custom_jvp
def _closest(closest_point, tangent_projection, second_form, manifold, p):
    return closest_point(manifold, p)


@_closest.def_jvp
def _closest_jvp(primals, tangents):
    closest_point, tangent_projection, second_form, manifold, p = primals
    *others, dp = tangents
    if jax.tree.leaves(others):
        raise NotImplementedError(
            "implicit_projection: derivatives with respect to the fields of "
            f"`{type(manifold).__name__}` were asked for; write its `project` with "
            "`implicit_solution`, or hold the manifold fixed."
        )
    y = _closest(closest_point, tangent_projection, second_form, manifold, p)
    shape, size = y.shape, y.size
    basis = jnp.eye(size).reshape(size, *shape)
    tangent = jax.vmap(lambda v: tangent_projection(manifold, y, v))(basis)

    def curvature(u, v):
        return jnp.sum(second_form(manifold, y, u, v) * (p - y))

    rows = jax.vmap(jax.vmap(curvature, (None, 0)), (0, None))
    operator = jnp.eye(size) - rows(tangent, tangent)
    dy = tangent.reshape(size, size).T @ dp.ravel()
    return y, jnp.linalg.solve(operator, dy).reshape(shape)
