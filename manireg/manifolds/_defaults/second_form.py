"""What a manifold can leave to automatic differentiation.

With a closest point projection alone, `second_form_of_projection`, `geodesic_exp` and
`shooting_log` supply the rest. The functions with loops are jitted, so that calls outside
of `jit` compile them once.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._base import AbstractManifold


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
