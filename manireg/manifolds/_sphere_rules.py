"""Coordinates of spheres, and points spread over them."""

import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import ScalarLike
from scipy.special import roots_gegenbauer

from .._source import Atlas, Chart

Rule = tuple[np.ndarray, np.ndarray]
"""Points `(Q, s)`, weights `(Q,)`."""


def circle(radius: ScalarLike) -> Chart:
    embed = Partial(_on_circle, np.asarray(radius, float))
    return Chart(np.zeros(1), np.array([2 * np.pi]), (True,), embed)


def _on_circle(radius, u):
    return jnp.stack([jnp.cos(u[0]), jnp.sin(u[0])]) * radius


def cube(dim: int, radius: ScalarLike) -> Atlas:
    """Equal angles along the axes of each face: tan u is the point on the face."""
    s = dim + 1
    turns = [np.roll(np.eye(s), i, axis=1) for i in range(s)]
    labels = np.stack([sign * turn.ravel() for turn in turns for sign in (1.0, -1.0)])

    corner = np.full((2 * s, dim), np.pi / 4)
    embed = Partial(_on_face, np.asarray(radius, float))
    return Atlas(-corner, corner, labels, embed)


def _on_face(radius, u, label):
    s = len(u) + 1
    on_face = jnp.append(1.0, jnp.tan(u)) @ label.reshape(s, s)
    return radius * on_face / jnp.sqrt(jnp.sum(on_face**2))


def fibonacci(n: int, radius: ScalarLike) -> Rule:
    """`n` points on S^2, of equal shares."""
    i = np.arange(n) + 0.5
    z, longitude = 1 - 2 * i / n, np.pi * (1 + 5**0.5) * i
    rho = np.sqrt(1 - z**2)
    points = np.stack([rho * np.cos(longitude), rho * np.sin(longitude), z], axis=1)
    radius = np.asarray(radius)
    return radius * points, np.full(n, 4 * np.pi * radius**2 / n)


def gauss(dim: int, n: int, radius: ScalarLike) -> Rule:
    """Product rule of about `n` points on S^dim, exact for polynomials: Gauss-Gegenbauer
    in the last coordinate, the sphere below in the others, down to the trapezoid rule on
    the circle."""
    order = max(4, round((n / 2) ** (1 / dim)))
    angle = 2 * np.pi * np.arange(2 * order) / (2 * order)
    points = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    weights = np.full(len(points), np.pi / order)
    for m in range(2, dim + 1):
        z, w = roots_gegenbauer(order, (m - 1) / 2)
        rho = np.sqrt(1 - z**2)[:, None, None]
        rows = np.broadcast_to(z[:, None, None], (len(z), len(points), 1))
        points = np.concatenate([rho * points, rows], axis=2).reshape(-1, m + 1)
        weights = np.outer(w, weights).ravel()
    radius = np.asarray(radius)
    return radius * points, radius**dim * weights
