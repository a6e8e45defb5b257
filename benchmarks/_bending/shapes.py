"""Pairs of surfaces with a known map between them: sheets and tubes that are bent.

Every shape is a map from a chart (u, v) to source and to target, so the correspondence is
exact. On cylinder and roll it is an isometry. Straightening a tube is none in general
(the outside of the bend is longer): there the map that keeps arc length along the centre
line and angle around it is the truth, by definition.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid

Chart = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""(u, v) (n, 2) -> points (n, 3), unit normals (n, 3)."""


class Shape(NamedTuple):
    source: Chart
    target: Chart
    lengths: tuple[float, float]
    """Of the chart: u in [0, lengths[0]], v in [0, lengths[1]]."""
    periodic: bool
    """Whether v closes up."""

    @property
    def size(self) -> float:
        """The unit of all errors: the side of the square with the area of the chart."""
        return float(np.sqrt(np.prod(self.lengths)))


def flat(uv):
    points = np.column_stack([uv, np.zeros(len(uv))])
    return points, np.tile([0.0, 0.0, 1.0], (len(uv), 1))


def around(radius: float, uv):
    """Cylinder: u around it, v along the axis."""
    angle = uv[:, 0] / radius
    normal = np.column_stack([-np.sin(angle), np.cos(angle), 0 * angle])
    axis = np.column_stack([0 * angle, 0 * angle, uv[:, 1]])
    return radius * normal + axis, normal


ROLL_RADIUS, ROLL_PITCH, ROLL_TURNS = 0.5, 1 / 3, 1.5
# a little longer than needed: tangents at the end by differences
_TURN = np.linspace(0, 2 * np.pi * ROLL_TURNS + 0.1, 20001)
_SPEED = np.hypot(
    ROLL_RADIUS + ROLL_PITCH * _TURN / (2 * np.pi), ROLL_PITCH / (2 * np.pi)
)
_ROLLED = cumulative_trapezoid(_SPEED, _TURN, initial=0)
ROLL_LENGTH = float(np.interp(2 * np.pi * ROLL_TURNS, _TURN, _ROLLED))


def roll(uv):
    """Archimedean spiral by arc length; the sheets are ROLL_PITCH apart, seven times
    the spacing of 10,000 points."""
    angle = np.interp(uv[:, 0], _ROLLED, _TURN)
    slope = ROLL_PITCH / (2 * np.pi)
    radius = ROLL_RADIUS + slope * angle
    out = np.column_stack([-np.sin(angle), np.cos(angle), 0 * angle])
    forward = np.column_stack([-np.cos(angle), -np.sin(angle), 0 * angle])
    normal = radius[:, None] * out - slope * forward
    points = radius[:, None] * out
    points[:, 2] = uv[:, 1]
    return points, normal / np.linalg.norm(normal, axis=1, keepdims=True)


TUBE_RADIUS, TUBE_BEND, TUBE_ANGLE = 0.4, 1.4, 1.5 * np.pi


def bent_tube(uv):
    """Swept along three quarters of a circle of radius TUBE_BEND."""
    angle, phi = uv[:, 0] / TUBE_BEND, uv[:, 1] / TUBE_RADIUS
    out = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    normal = np.cos(phi)[:, None] * out + np.sin(phi)[:, None] * [0.0, 0.0, 1.0]
    return TUBE_BEND * out + TUBE_RADIUS * normal, normal


def straight_tube(uv):
    phi = uv[:, 1] / TUBE_RADIUS
    normal = np.column_stack([np.cos(phi), 0 * phi, np.sin(phi)])
    axis = np.column_stack([0 * phi, uv[:, 0], 0 * phi])
    return TUBE_RADIUS * normal + axis, normal


WIDTH = 3.0  # of the sheets, along the axis
SHAPES = {
    # three quarters of a turn
    "cylinder": Shape(
        flat, lambda uv: around(1.0, uv), (1.5 * np.pi, WIDTH), periodic=False
    ),
    "roll": Shape(flat, roll, (ROLL_LENGTH, WIDTH), periodic=False),
    "tube": Shape(
        bent_tube,
        straight_tube,
        (TUBE_BEND * TUBE_ANGLE, 2 * np.pi * TUBE_RADIUS),
        periodic=True,
    ),
}
