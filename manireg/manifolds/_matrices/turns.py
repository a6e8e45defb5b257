"""Rates of turn of matrices R(x) of rotation in space, and their unit quaternions."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def is_body(axes: str) -> bool:
    if axes not in ("space", "body"):
        raise ValueError(f'axes: expected "space" or "body", found {axes!r}.')
    return axes == "body"


def turn_rate(
    r: Float[Array, "*k 3 3"], v: Float[Array, "*k 3 3"], axes: str
) -> Float[Array, "*k 3"]:
    r"""$\omega$ with $v = [\omega]_\times r$ about axes of space, $v = r [\omega]_\times$
    about those of the body; of v its tangent part."""
    transposed = jnp.swapaxes(r, -1, -2)
    turn = transposed @ v if is_body(axes) else v @ transposed
    skew = (turn - jnp.swapaxes(turn, -1, -2)) / 2
    return jnp.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)


def quaternion_turn_rate(
    q: Float[Array, "... 4"], v: Float[Array, "... 4"], axes: str
) -> Float[Array, "... 3"]:
    r"""The same of quaternions w, x, y, z of any length with derivatives v: the vector
    part of $2 \bar q v / |q|^2$ (body) or $2 v \bar q / |q|^2$ (space)."""
    side = 1.0 if is_body(axes) else -1.0
    w, a, s, b = q[..., :1], q[..., 1:], v[..., :1], v[..., 1:]
    vector = w * b - s * a - side * jnp.cross(a, b)
    return 2 * vector / jnp.sum(q**2, axis=-1, keepdims=True)


def cross_matrices(w: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3 3"]:
    r"""$[w]_\times$, which takes v to $w \times v$."""
    return np.swapaxes(np.cross(w[..., None, :], np.eye(3)), -1, -2)
