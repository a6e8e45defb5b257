"""What is read off a jet of Psi: functions of one point, for `jet_covariances.pushed`."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp

from .._objective.terms import project_flat
from ..manifolds._defaults.frames import coordinates, orthonormal_columns
from .derivatives import tangent_of_curve
from .readings import sphere_motion


def slope(target, psi, frame):
    """Of the projection, in the frame of the tangent space."""
    p = target.project(psi.reshape(target.point_shape))
    columns = jax.jacfwd(lambda q: project_flat(target, q))(psi)
    axes = orthonormal_columns(target, p, frame)
    return axes.T @ orthonormal_columns(target, p, columns)


def in_frame(target, psi, frame):
    """Near the map, whose own coordinates are 0."""
    p = target.project(psi[0].reshape(target.point_shape))
    here = jax.lax.stop_gradient(p)
    return coordinates(target, here, frame, (p - here).ravel())


def velocity_in_frame(target, psi, frame):
    """Its derivative is the covariant one: the frame is carried along."""
    p, velocity = _moving(target, psi)
    here, v = jax.lax.stop_gradient((p, velocity))
    value = coordinates(target, here, frame, velocity.ravel())
    if target.isometric:
        return value
    # the connection along the displacement: half of what is quadratic in the velocity
    bend = lambda v: target.covariant_derivative([here, v, jnp.zeros_like(v)])
    turned = 0.5 * jax.jvp(bend, (v,), (p - here,))[1]
    return value + orthonormal_columns(target, here, frame).T @ turned.ravel()


def turn_in_space(target, psi):
    return target.angular_velocity(*_moving(target, psi), "space")


def turn_in_body(target, psi):
    return target.angular_velocity(*_moving(target, psi), "body")


def twist_in_space(target, psi):
    return target.twist(*_moving(target, psi), "space")


def twist_in_body(target, psi):
    return target.twist(*_moving(target, psi), "body")


def _moving(target, psi):
    """Value and velocity."""
    p = target.project(psi[0].reshape(target.point_shape))
    return p, tangent_of_curve(target, psi)


class Read(eqx.Module):
    """A user's function of value and velocity. Equal where the function is."""

    function: Callable = eqx.field(static=True)

    def __call__(self, target, psi):
        return self.function(*_moving(target, psi))


def motion(target, psi):
    """Speed, azimuth, and the Euler pole."""
    found = sphere_motion(*_moving(target, psi))
    return jnp.concatenate([jnp.stack([found.speed, found.azimuth]), found.euler_pole])
