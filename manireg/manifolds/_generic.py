"""What a manifold can leave to automatic differentiation.

With a closest point projection alone, `second_form_of_projection`, `geodesic_exp` and
`shooting_log` supply the rest. `implicit_solution` and `implicit_projection` give an
iterative solver derivatives of all orders, without differentiating the iteration.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._base import AbstractManifold


_SEGMENTS = 8  # of the discrete curve from which `shooting_log` starts
_SWEEPS = 30  # of the relaxation of that curve; the slowest mode shrinks to 9 %
_SHOTS = 40  # cap on the Newton iterations; 3 to 6 are usual


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

    **Arguments:** `project` the closest point projection, broadcasting; `p`, `u`, `v` of
    shape `(..., *point_shape)`.
    """
    p, u, v = jnp.broadcast_arrays(p, u, v)

    def along_u(x):
        return jax.jvp(project, (x,), (u,))[1]

    return jax.jvp(along_u, (p,), (v,))[1]


def geodesic_exp(
    manifold: AbstractManifold,
    p: Float[Array, "..."],
    v: Float[Array, "..."],
    steps: int = 64,
) -> Float[Array, "..."]:
    r"""End point at time 1 of $y'' = II_y(y', y')$, $y(0) = p$, $y'(0) = v$, by the
    classical Runge-Kutta method of order 4.

    The drift off N is of the order of the integration error, so the projection is left
    to the end. Uses `second_fundamental_form` (at points and for vectors that are off N
    by that much) and `project`.

    **Arguments:** `steps` number of equal steps; the error is about
    $(|v| \kappa / \text{steps})^4 / 100$ for the curvature $\kappa$ of the geodesic.
    """
    p, v = jnp.broadcast_arrays(p, v)
    h = 1.0 / steps

    def slope(y, w):
        return w, manifold.second_fundamental_form(y, w, w)

    def step(state, _):
        y, w = state
        y1, w1 = slope(y, w)
        y2, w2 = slope(y + h / 2 * y1, w + h / 2 * w1)
        y3, w3 = slope(y + h / 2 * y2, w + h / 2 * w2)
        y4, w4 = slope(y + h * y3, w + h * w3)
        y = y + h / 6 * (y1 + 2 * y2 + 2 * y3 + y4)
        w = w + h / 6 * (w1 + 2 * w2 + 2 * w3 + w4)
        return (y, w), None

    (y, _), _ = jax.lax.scan(step, (p, v), None, length=steps)
    return manifold.project(y)


def shooting_log(
    manifold: AbstractManifold, p: Float[Array, "..."], q: Float[Array, "..."]
) -> Float[Array, "..."]:
    r"""The tangent v at p with `manifold.exp(p, v) == q`, by Newton shooting, for a
    manifold without a closed logarithm.

    Starts from a discrete curve: the chord projected to N and relaxed by
    $y_i \leftarrow \pi((y_{i-1} + y_{i+1})/2)$, so the geodesic found is a local minimum
    of the length near the chord. That is the shortest one well inside the injectivity
    radius, and usually beyond it. Derivatives of all orders exist, also at p == q; p and
    q are projected first. Uses `project`, `tangent_projection` and `exp`.
    """
    log = eqx.Partial(_shoot, manifold)
    p, q = manifold.project(p), manifold.project(q)
    return broadcast_points(log, manifold.point_shape)(p, q)


@eqx.filter_custom_jvp
def _shoot(manifold: AbstractManifold, p: Array, q: Array) -> Array:
    shape, size = p.shape, p.size
    basis = jnp.eye(size).reshape(size, *shape)
    matrix = manifold.tangent_projection(p, basis).reshape(size, size)
    frame = jnp.linalg.eigh((matrix + matrix.T) / 2)[1][:, size - manifold.dim :]

    def miss(x):
        gap = manifold.exp(p, (frame @ x).reshape(shape)) - q
        return gap.ravel(), gap.ravel()

    def shot(x):
        jacobian, gap = jax.jacfwd(miss, has_aux=True)(x)
        return gap, jacobian

    def move(state):
        x, gap, jacobian, damping, _, count = state
        normal = jacobian.T @ jacobian + damping * jnp.eye(manifold.dim)
        dx = -jnp.linalg.solve(normal, jacobian.T @ gap)
        new_gap, new_jacobian = shot(x + dx)
        better = jnp.sum(new_gap**2) <= jnp.sum(gap**2)
        x, gap, jacobian = jax.tree.map(
            lambda new, old: jnp.where(better, new, old),
            (x + dx, new_gap, new_jacobian),
            (x, gap, jacobian),
        )
        damping = jnp.where(better, 0.0, jnp.maximum(10 * damping, 1e-2))
        return x, gap, jacobian, damping, jnp.sum(dx**2), count + 1

    def moving(state):
        x, _, _, _, moved, count = state
        return (moved > 1e-26 * jnp.sum(x**2) + rounding) & (count < _SHOTS)

    rounding = 1e-31 * jnp.sum(p**2 + q**2)
    x = frame.T @ _relaxed_start(manifold, p, q).ravel()
    far = jnp.array(jnp.inf, x.dtype)
    state = (x, *shot(x), jnp.zeros_like(far), far, jnp.array(0))
    return (frame @ jax.lax.while_loop(moving, move, state)[0]).reshape(shape)


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
    if dp is None:
        dp = jnp.zeros_like(p)
    dend, turn = eqx.filter_jvp(shot, (manifold, p, v), (dmanifold, dp, None))[1]
    gap = (-dend if dq is None else dq - dend).ravel()
    normal = jacobian.T @ jacobian + jnp.eye(size) - tangent
    x = tangent @ jnp.linalg.solve(normal, jacobian.T @ gap)
    return v, turn + x.reshape(shape)


def _relaxed_start(manifold: AbstractManifold, p: Array, q: Array) -> Array:
    """First guess of log_p(q): direction and length of a relaxed discrete curve."""
    times = jnp.linspace(0.0, 1.0, _SEGMENTS + 1)[1:-1]
    times = times.reshape(-1, *[1] * p.ndim)
    # a small bend, so that no symmetry holds the curve on a saddle of the length
    bend = jnp.cos(1.0 + jnp.arange(p.size)).reshape(p.shape)
    bend = 1e-2 * jnp.sqrt(jnp.sum((q - p) ** 2)) * bend
    inner = manifold.project(p + times * (q - p) + times * (1 - times) * bend)

    def sweep(_, inner):
        curve = jnp.concatenate([p[None], inner, q[None]])
        return manifold.project((curve[:-2] + curve[2:]) / 2)

    inner = jax.lax.fori_loop(0, _SWEEPS, sweep, inner)
    curve = jnp.concatenate([p[None], inner, q[None]])
    steps = jnp.diff(curve, axis=0).reshape(_SEGMENTS, -1)
    length = jnp.sum(jnp.sqrt(jnp.sum(steps**2, axis=1)))
    direction = manifold.tangent_projection(p, inner[0] - p)
    size = jnp.sqrt(jnp.sum(direction**2))
    return direction * jnp.where(size > 0, length / jnp.where(size > 0, size, 1), 0)


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
    v)` and `second_fundamental_form(manifold, y, u, v)`, needed on N only. Fields of the
    manifold get no derivatives (asking for them raises): use `implicit_solution` there.
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
