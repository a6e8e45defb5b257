"""Geodesics of the source beyond second order: the partial derivatives of exp_x(E u) at
u = 0, for energies of order three and four.

With the geodesic spray - a point and a velocity move by the velocity and by an
acceleration - all derivatives of a geodesic follow from the equation it solves,
differentiated along itself.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._programs.sizes import at_each
from .polarisation import components, directions


def geodesics_of_manifold(
    manifold: Any,
    points: Float[np.ndarray, "Q s"],
    frames: Float[np.ndarray, "Q s m"],
    order: int,
) -> Float[np.ndarray, "Q R s"]:
    """Rows of orders 3 to `order`: y'' = II_y(y', y')."""
    return at_each(_on_manifold, (manifold, order), points, frames)


def geodesics_of_chart(
    chart: Any,
    order: int,
    inverse: Float[np.ndarray, "Q m m"],
    *u: Float[np.ndarray, "Q _"],
) -> Float[np.ndarray, "Q R s"]:
    """The same in the coordinates of a `Chart` or `Atlas`, the first of `u`:
    $u'' = -\\Gamma_u(u', u')$. `inverse`: columns are the frame in coordinates."""
    return at_each(_in_chart, (chart.embed, chart.metric, order), inverse, *u)


def christoffel(metric: Callable[..., Array], *u) -> Float[Array, "m m m"]:
    r"""$\Gamma^c_{ab} = \frac12 g^{cd} (\partial_a g_{db} + \partial_b g_{da} -
    \partial_d g_{ab})$ of a metric of coordinates, the first of `u`."""
    slope = jax.jacfwd(metric)(*u)
    along = jnp.einsum("dba->dab", slope) + slope - jnp.einsum("abd->dab", slope)
    m = len(slope)
    return 0.5 * jnp.linalg.solve(metric(*u), along.reshape(m, -1)).reshape(m, m, m)


def _on_manifold(owner, x, frame):
    manifold, order = owner
    shape = manifold.point_shape

    def acceleration(y, velocity):
        y, velocity = y.reshape(shape), velocity.reshape(shape)
        return manifold.second_fundamental_form(y, velocity, velocity).ravel()

    return _rows(acceleration, acceleration, x, frame, order)


def _in_chart(owner, inverse, u, *label):
    embed, metric, order = owner
    embedded = lambda u: embed(u, *label)

    def velocity(u, du):
        return jax.jvp(embedded, (u,), (du,))[1]

    def acceleration(u, du):
        if metric is not None:
            return -jnp.einsum("cab,a,b->c", christoffel(metric, u, *label), du, du)
        along = lambda u: velocity(u, du)
        bend = jax.jvp(along, (u,), (du,))[1]
        tangent = jax.jacfwd(embedded)(u)
        return -jnp.linalg.solve(tangent.T @ tangent, tangent.T @ bend)

    second = _derivative_along(velocity, acceleration)
    return _rows(second, acceleration, u, inverse, order)


def _rows(second: Callable, acceleration: Callable, x, frame, order: int):
    """`second`: the second derivative of the geodesic with a given point and velocity."""
    m, rows, derivative = frame.shape[1], [], second
    for degree in range(3, order + 1):
        derivative = _derivative_along(derivative, acceleration)
        velocities = directions(m, degree) @ frame.T
        values = jax.vmap(derivative, in_axes=(None, 0))(x, velocities)
        rows.append(components(m, degree) @ values)
    return jnp.concatenate(rows)


def _derivative_along(f: Callable, acceleration: Callable) -> Callable:
    """Of f(point, velocity) along the geodesic."""
    return lambda x, v: jax.jvp(f, (x, v), (v, acceleration(x, v)))[1]
