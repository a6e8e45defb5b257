"""What is read off a jet of Psi: functions of one point, for `jet_covariances.pushed`."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp

from .._objective.terms import project_flat
from .derivatives import tangent_of_curve
from .readings import sphere_motion


def slope(target, psi, frame):
    """Of the projection, in the frame of the tangent space."""
    return frame.T @ jax.jacfwd(lambda q: project_flat(target, q))(psi)


def in_frame(target, psi, frame):
    return frame.T @ project_flat(target, psi[0])


def _velocity(target, psi):
    return tangent_of_curve(target, psi)


def velocity_in_frame(target, psi, frame):
    return frame.T @ _velocity(target, psi).ravel()


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
    return target.project(psi[0].reshape(target.point_shape)), _velocity(target, psi)


class Read(eqx.Module):
    """A user's function of value and velocity. Equal where the function is."""

    function: Callable = eqx.field(static=True)

    def __call__(self, target, psi):
        return self.function(*_moving(target, psi))


def motion(target, psi):
    """Speed, azimuth, and the Euler pole."""
    found = sphere_motion(target.project(psi[0]), _velocity(target, psi))
    return jnp.concatenate([jnp.stack([found.speed, found.azimuth]), found.euler_pole])
