"""Derivatives of all orders for what an iteration finds, without differentiating the
iteration."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._base import AbstractManifold
from .second_form import broadcast_points


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
