"""Poses: rotations and positions of a rigid body."""

import math
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, ScalarLike

from ..._input.numbers import Numbers, as_numbers
from ..._source import Atlas
from .._base import AbstractManifold
from .._euclidean import Euclidean
from .._membership import is_concrete
from .._product import Product
from .poses import check_covariances, matrices_of, quaternions_of, rotations_of
from .special_orthogonal import SpecialOrthogonal
from .turns import cross_matrices, is_body


class SpecialEuclidean(AbstractManifold):
    r"""$SE(3)$, the poses (R, t) of a rigid body, as the product of rotations and space:
    $d^2 = \theta^2 + |t - t'|^2 / \ell^2$ with the angle $\theta$ of $R^\top R'$ in
    radians. Geodesics turn at a constant rate while t moves on a straight line, whatever
    point of the body t is. No metric of SE(3) is the same seen from both sides; this one
    is the same for all fixed frames, and for all frames of the body with the same origin.

    **Arguments:**

    - `n`: 3. (In the plane: `Product(SpecialOrthogonal(2), Euclidean(2), scales=...)`.)
    - `length`: $\ell$ (default 1), in the unit of t: so far a move counts as much as a
      turn by one radian. Data know it: $\sigma_t / \sigma_R$ if noise has these standard
      deviations along and about each axis.

    A point is $(R / \sqrt 2, t / \ell)$, flattened to 12 numbers, which is isometric.
    `from_pose` and `from_matrices` make points, `to_pose` and `to_matrices` read them.

    **Raises** ValueError for another n, and a length that is not positive.

    **Example:** half a metre is as far as a turn by one radian.

    ```python
    space = mr.SpecialEuclidean(3, length=0.5)
    places = [[0.0, 0.0, 0.0], [0.0, 0.5, 0.0]]
    p, q = space.from_pose(places, [[1.0, 0, 0, 0]] * 2, order="wxyz")
    space.squared_distance(p, q)  # 1.000
    ```

    Poses with covariances, smoothed:

        space = mr.SpecialEuclidean(3, length=0.5)
        y = space.from_pose(positions, quaternions, order="xyzw")
        noise = space.noise_of(y, covariances, axes="body")  # precision and frames
        model = mr.fit(mr.Interval(0, 60), space, seconds, y, **noise)
        positions, quaternions = space.to_pose(model(t), order="xyzw")
    """

    n: int = eqx.field(static=True)
    length: ScalarLike = 1.0

    def __check_init__(self):
        if self.n != 3:
            raise ValueError(
                f"SpecialEuclidean: `n` must be 3, found {self.n}. In other dimensions "
                "take Product(SpecialOrthogonal(n), Euclidean(n), scales=...)."
            )
        known = np.asarray(self.length) if is_concrete(self.length) else np.ones(())
        if known.shape != () or not 0 < known < np.inf:
            raise ValueError(
                f"SpecialEuclidean: `length` must be positive, found {self.length}."
            )

    @property
    def _product(self) -> Product:
        scales = jnp.stack([jnp.asarray(math.sqrt(0.5)), 1 / jnp.asarray(self.length)])
        return Product(SpecialOrthogonal(3), Euclidean(3), scales=scales)

    def from_pose(
        self, position: Numbers, quaternion: Numbers, *, order: str
    ) -> Float[Array, "... 12"]:
        """Points of positions `(..., 3)` and unit quaternions `(..., 4)` or scipy's
        `Rotation`, of the body in space; `order` of the quaternion's numbers: `"wxyz"`,
        or `"xyzw"` as in ROS, TUM files and scipy. q and -q are the same.

        **Raises** ValueError for other shapes and orders, and where the length of a
        quaternion is not 1 to a thousandth; else it is made 1."""
        return self._of(rotations_of(quaternion, order), _vectors("position", position))

    def to_pose(
        self, points: Numbers, *, order: str
    ) -> tuple[Float[np.ndarray, "... 3"], Float[np.ndarray, "... 4"]]:
        """The inverse of `from_pose`, quaternions with the sign that continues the one
        before along the first axis (the first: w >= 0)."""
        rotation, position = self.split(as_numbers("points", points))
        return np.asarray(position), quaternions_of(np.asarray(rotation), order)

    def from_matrices(self, matrices: Numbers) -> Float[Array, "... 12"]:
        """Points of homogeneous matrices `(..., 4, 4)` or `(..., 3, 4)` from coordinates
        of the body to those of space; scipy's `RigidTransform`, too.

        **Raises** ValueError for other shapes, a last row that is not 0, 0, 0, 1 and
        rotations that are none to a thousandth; the closest ones are taken."""
        return self._of(*matrices_of(matrices))

    def to_matrices(self, points: Numbers) -> Float[np.ndarray, "... 4 4"]:
        """The inverse of `from_matrices`."""
        rotation, position = map(np.asarray, self.split(as_numbers("points", points)))
        found = np.zeros((*position.shape[:-1], 4, 4))
        found[..., :3, :3], found[..., :3, 3], found[..., 3, 3] = rotation, position, 1
        return found

    def frames(self, points: Numbers, axes: str) -> Float[np.ndarray, "k 12 6"]:
        """Orthonormal frames of the tangent spaces at k points: turns about the three
        axes of the body or of space, then moves along them."""
        rotation, position = map(np.asarray, self.split(as_numbers("points", points)))
        if position.ndim != 2:
            raise ValueError(f"points: expected (k, 12), found {np.shape(points)}.")
        cross, unit = cross_matrices(np.eye(3)), np.eye(3)
        body = is_body(axes)
        r = rotation[:, None]
        turns = r @ cross if body else cross @ r
        moves = (
            np.swapaxes(rotation, 1, 2)
            if body
            else np.broadcast_to(unit, r[:, 0].shape)
        )
        moves = float(np.asarray(self.length)) * moves
        still = np.zeros_like(turns), np.zeros_like(moves)
        each = self.join(turns, still[1]), self.join(still[0], moves)
        return np.swapaxes(np.concatenate(each, axis=1), 1, 2)

    def noise_of(
        self, points: Numbers, covariances: Numbers, *, axes: str
    ) -> dict[str, Any]:
        r"""`precision` and `frames` for `mr.fit` of k poses with covariances `(k, 6, 6)`,
        or one for all, of the error's rotation vector (radians), then position (in the
        unit of t).

        - `axes`: in which these are: `"body"`, $R \exp[\rho]_\times$ and $t + R \tau$, as
          GTSAM's Pose3 has it; `"space"`, $\exp[\rho]_\times R$ and $t + \tau$, as in ROS,
          which lists the position first: take `c[:, i][:, :, i]` with
          `i = [3, 4, 5, 0, 1, 2]`.

        **Raises** ValueError for covariances that are not symmetric and positive
        definite, and other names of axes."""
        frames = self.frames(points, axes)
        given = check_covariances(as_numbers("covariances", covariances), len(frames))
        unit = self._units
        return {
            "precision": np.linalg.inv(given / np.outer(unit, unit)),
            "frames": frames,
        }

    def covariances_of(
        self, points: Numbers, covariance: Numbers, frame: Numbers, *, axes: str
    ) -> Float[np.ndarray, "k 6 6"]:
        """The inverse: from `(k, 6, 6)` in orthonormal frames `(k, 12, 6)`, as
        `posterior.covariance` has them, to rotation vectors and positions."""
        turn = np.swapaxes(self.frames(points, axes), 1, 2) @ np.asarray(frame)
        found = turn @ np.asarray(covariance) @ np.swapaxes(turn, 1, 2)
        return found * np.outer(self._units, self._units)

    def angular_velocity(
        self, p: Float[Array, "..."], v: Float[Array, "..."], axes: str
    ) -> Float[Array, "... 3"]:
        rotations = self._product.factors[0]
        return rotations.angular_velocity(self.split(p)[0], self.split(v)[0], axes)

    def twist(
        self, p: Float[Array, "..."], v: Float[Array, "..."], axes: str
    ) -> Float[Array, "... 6"]:
        """Angular velocity, then that of t, along the same axes."""
        turn = self.angular_velocity(p, v, axes)
        rotation, move = self.split(p)[0], self.split(v)[1]
        if is_body(axes):
            move = jnp.einsum("...ji,...j->...i", rotation, move)
        return jnp.concatenate([turn, move], axis=-1)

    def split(self, p: Float[Any, "..."]) -> tuple[Float[Any, "..."], ...]:
        """Rotation matrices and positions of points, or of vectors."""
        return self._product.split(p)

    def join(self, *parts: Float[Any, "..."]) -> Float[Array, "..."]:
        """The inverse of `split`."""
        return self._product.join(*parts)

    @property
    def dim(self) -> int:
        return 6

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (12,)

    @property
    def reach(self) -> ScalarLike:
        return self._product.reach

    @property
    def injectivity_radius(self) -> ScalarLike:
        """pi: half a turn."""
        return self._product.injectivity_radius

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        return self._product.project(p)

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return self._product.tangent_projection(p, v)

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return self._product.second_fundamental_form(p, u, v)

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return self._product.squared_distance(p, q)

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return self._product.exp(p, v)

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return self._product.log(p, q)

    def covariant_derivative(
        self, psi: Sequence[Float[Array, "..."]]
    ) -> Float[Array, "..."]:
        return self._product.covariant_derivative(psi)

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """Random rotations, and positions of standard deviation 1 in the unit of t."""
        return self._product.random_points(key, n)

    def product(
        self, around: np.ndarray | None
    ) -> "Sequence[tuple[AbstractManifold, np.ndarray | None, float]]":
        return self._product.product(around)

    def atlas(self, around: np.ndarray | None) -> Atlas | None:
        return self._product.atlas(around)

    def parts(self, *arrays: Any) -> "list[tuple]":
        (_, *rotations), (_, *positions) = self._product.parts(*arrays)
        return [("rotations", *rotations), ("positions", *positions)]

    @property
    def _units(self) -> Float[np.ndarray, "6"]:
        """Radians and units of t of a unit of distance."""
        return np.array([1.0] * 3 + [float(np.asarray(self.length))] * 3)

    def _of(self, rotations: np.ndarray, positions: np.ndarray) -> Float[Array, "..."]:
        batch = np.broadcast_shapes(rotations.shape[:-2], positions.shape[:-1])
        if rotations.shape[:-2] != batch or positions.shape[:-1] != batch:
            raise ValueError(
                f"SpecialEuclidean: {rotations.shape[:-2]} rotations and "
                f"{positions.shape[:-1]} positions; give as many of each."
            )
        return self.join(rotations, positions)


def _vectors(name: str, values: Numbers) -> Float[np.ndarray, "... 3"]:
    found = as_numbers(name, values)
    if found.shape[-1:] != (3,):
        raise ValueError(f"{name}: expected shape (..., 3), found {found.shape}.")
    return found
