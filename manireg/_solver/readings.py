"""Derivatives of fitted maps with names and units. Pure functions: of one point or many,
also of samples, under `jit`, `vmap` and `grad`."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from .._input.numbers import Numbers, as_numbers
from .._sources.checks import is_concrete
from ..manifolds._matrices.turns import is_body, turn_rate


def angular_velocity(
    rotation: Numbers, velocity: Numbers, axes: str = "space"
) -> Float[Array, "... 3"]:
    r"""Angular velocity of a rotation R(x) of space, in radians per unit of x: $\omega$
    with $\dot R = [\omega]_\times R$, $[\omega]_\times v = \omega \times v$.

    **Arguments:**

    - `rotation`: R, `(..., 3, 3)`, values of a map into `SpecialOrthogonal(3)`.
    - `velocity`: $\dot R$, of the same shape, from `RegressionMap.velocity` or columns of
      a `differential`; its part that is not tangent is left out.
    - `axes`: `"space"` (default), the fixed ones that R maps to; `"body"`, those that it
      maps from and that turn with the body: $R^T \omega$, with
      $\dot R = R [R^T \omega]_\times$.

    **Returns** `(..., 3)`: its direction is the axis of the turn, by the right hand, its
    length the rate.

    **Raises** ValueError for other names of axes and shapes.

    **Example:** two radians a second about the third axis.

    ```python
    turn = Rotation.from_rotvec([0.0, 0.0, 0.5]).as_matrix()
    rate = turn @ np.array([[0, -2.0, 0], [2.0, 0, 0], [0, 0, 0]])  # R [w]_x
    mr.angular_velocity(turn, rate, axes="body")  # 0.0, 0.0, 2.0
    ```
    """
    is_body(axes)  # raises for other names
    r = _arrays("rotation", rotation, (3, 3))
    v = _arrays("velocity", velocity, (3, 3))
    r, v = jnp.broadcast_arrays(r, v)
    return turn_rate(r, v, axes)


class SphereMotion(NamedTuple):
    """Of a point that moves on a sphere, as `sphere_motion` finds it."""

    speed: Float[Array, "..."]
    """Radians of arc per unit of x."""
    azimuth: Float[Array, "..."]
    """Degrees from north, clockwise (90 is east), in [0, 360)."""
    euler_pole: Float[Array, "... 3"]
    """The unit vector around which, counterclockwise, the point turns."""


def sphere_motion(p: Numbers, v: Numbers) -> SphereMotion:
    r"""How fast, in which direction and around which pole a point moves on a sphere
    around the origin, with the third axis to the north.

    **Arguments:** `p`, `(..., 3)`, points of a sphere of any radius; `v`, `(..., 3)`,
    their velocities, of which the tangent part counts.

    **Returns** a `SphereMotion`:

    - `speed`: $|p \times v| / |p|^2$, in radians per unit of x; `np.degrees` of it, or
      times the radius, are speeds in other units.
    - `azimuth`: the bearing, in degrees clockwise from north, in [0, 360).
    - `euler_pole`: $p \times v / |p \times v|$. The great circle along v turns around it;
      a path that bends turns around another one, too.

    Azimuth and pole are NaN where v = 0, the azimuth also where p is a geographic pole.

    **Raises** ValueError for other shapes.

    **Example:** along the equator to the east, around the north pole.

    ```python
    motion = mr.sphere_motion([1.0, 0.0, 0.0], [0.0, 2.0, 0.0])
    motion.speed  # 2.0
    motion.azimuth  # 90.0
    motion.euler_pole  # 0.0, 0.0, 1.0
    ```
    """
    p, v = jnp.broadcast_arrays(_arrays("p", p, (3,)), _arrays("v", v, (3,)))
    turn = jnp.cross(p, v)
    moves = jnp.any(turn != 0, axis=-1)
    length, radius = _norm(turn), _norm(p)
    # both times the distance of p from the axis
    east = turn[..., 2]
    north = (turn[..., 0] * p[..., 1] - turn[..., 1] * p[..., 0]) / radius
    azimuth = jnp.degrees(jnp.arctan2(east, north)) % 360
    azimuth = jnp.where(azimuth < 360, azimuth, 0.0)  # a rounding error to the west
    known = moves & jnp.any(p[..., :2] != 0, axis=-1)
    azimuth = jnp.where(known, azimuth, jnp.nan)
    return SphereMotion(length / radius**2, azimuth, turn / length[..., None])


def _norm(v: Float[Array, "... 3"]) -> Float[Array, "..."]:
    """Of derivative 0 at 0."""
    squared = jnp.sum(v**2, axis=-1)
    return jnp.where(squared > 0, jnp.sqrt(jnp.where(squared > 0, squared, 1.0)), 0.0)


def _arrays(name: str, values: Numbers, shape: tuple[int, ...]) -> Float[Array, "..."]:
    values = jnp.asarray(as_numbers(name, values) if is_concrete(values) else values)
    if values.shape[-len(shape) :] != shape:
        wanted = ", ".join(("...", *map(str, shape)))
        raise ValueError(f"{name}: expected shape ({wanted}), found {values.shape}.")
    return values
