"""The manifold interface: what a target (or a source) has to be able to do."""

import abc
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, ScalarLike

from .._source import AbstractSource, Chart
from ._defaults.covariant_derivative import covariant_derivative
from ._membership import by_reach, check_on


class AbstractManifold(AbstractSource):
    r"""A Riemannian manifold N of dimension n in a vector space of arrays of shape
    `point_shape` (flattened: $\mathbb{R}^t$), isometrically embedded unless it brings a
    metric of its own (`isometric`).

    Letters: `p`, `q` points (or ambient points near N), `u`, `v` ambient vectors. Every
    method accepts leading batch dimensions, which broadcast: points and vectors are
    `(..., *point_shape)`. All methods are pure and differentiable in JAX.

    A manifold of your own subclasses this and overrides the methods below;
    `manireg.manifolds.second_form_of_projection`, `geodesic_exp` and `shooting_log` turn
    most of them into one line. `manireg.check_manifold` then runs the laws.

    As a source it is sampled at quasi-uniform points, unless it has a `chart` (see
    `manireg.AbstractSource`), which integrates to more digits.
    """

    @property
    @abc.abstractmethod
    def reach(self) -> ScalarLike:
        """Largest r such that every ambient point closer than r has one closest point."""

    @property
    @abc.abstractmethod
    def injectivity_radius(self) -> ScalarLike:
        """Radius below which geodesics are unique shortest paths (or a lower bound)."""

    @abc.abstractmethod
    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        r"""Closest point $\pi(p) \in N$."""

    @abc.abstractmethod
    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""Orthogonal projection of `v` onto $T_{\pi(p)}N$; `p` may lie off N."""

    @abc.abstractmethod
    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""$II_p(u, v)$, the normal part of the ambient derivative, for tangent u, v."""

    @abc.abstractmethod
    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """Squared geodesic distance of two points of N, shape `(...)`. First and second
        derivatives are finite at p = q."""

    @abc.abstractmethod
    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """End point of the geodesic from `p` with initial velocity `v`, at time 1."""

    @abc.abstractmethod
    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """Initial velocity at `p` of the shortest geodesic that reaches `q` at time 1."""

    @abc.abstractmethod
    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """`n` random points, `(n, *point_shape)`: uniform where N is compact and
        homogeneous, else some distribution of full support."""

    # The metric, where it is not that of the ambient space. One of your own can leave
    # this, and all that follows.

    @property
    def isometric(self) -> bool:
        """Whether the metric is that of the ambient space. One with another overrides the
        next three methods (and `squared_distance`, `exp`, `log`); `project` may then be
        any smooth retraction, `tangent_projection` any projection, and
        `second_fundamental_form` is the ambient derivative less the covariant one: the
        acceleration of geodesics."""
        return True

    def orthonormal(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""Coordinates of vectors tangent at `p` on N in which the metric is Euclidean,
        $g_p(u, v) = \langle o_p(u), o_p(v) \rangle$, of the shape of `v`, smooth in p;
        here `v` itself."""
        return v

    def from_orthonormal(
        self, p: Float[Array, "..."], c: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """The tangent vector with these coordinates."""
        return c

    def residual(
        self, y: Float[Array, "..."], p: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        r"""What p on N misses y on N by: $\log_y p$ to first order in p, in coordinates
        orthonormal at y. Here the chord."""
        return p - y

    def covariant_derivative(
        self, psi: Sequence[Float[Array, "..."]]
    ) -> Float[Array, "..."]:
        r"""$(D/ds)^{p-1} (\pi \circ \psi)'$ of a curve near N with the derivatives
        $\psi, \psi', \dots, \psi^{(p)}$, single points, in `orthonormal` coordinates;
        here by automatic differentiation of the projection and the second fundamental
        form."""
        return self.orthonormal(self.project(psi[0]), covariant_derivative(self, psi))

    # As a scan, as a source, as the place of data.

    def angular_velocity(
        self, p: Float[Array, "..."], v: Float[Array, "..."], axes: str
    ) -> Float[Array, "... 3"]:
        """Of a body whose orientation p is or holds, with the derivative v, about axes of
        the `"body"` or of `"space"`; ValueError where there is none."""
        raise ValueError(
            "angular_velocity: only of maps into SpecialOrthogonal(3) or "
            f"SpecialEuclidean(3), found {type(self).__name__}."
        )

    def twist(
        self, p: Float[Array, "..."], v: Float[Array, "..."], axes: str
    ) -> Float[Array, "... 6"]:
        """Angular, then linear velocity of a body whose pose p is, likewise."""
        raise ValueError(
            f"twist: only of maps into SpecialEuclidean(3), found {type(self).__name__}."
        )

    def nearest(self, p: Float[Array, "... s"]) -> Int[Array, "..."] | None:
        """Which of its patches are near ambient points, flattened; None: it has none."""
        return None

    def patches(self, index: Int[Array, "..."]) -> Any:
        """What it is near points that have these patches nearest, batched; without
        patches itself, everywhere."""
        return self

    def chart(self, around: np.ndarray | None) -> Chart | None:
        """None: sampled at points. Override it where there are global coordinates."""
        return None

    def squared_distances(
        self, p: Float[Array, "a s"], q: Float[Array, "b s"]
    ) -> Float[Array, "a b"]:
        """Geodesic ones."""
        p, q = self.from_ambient(p), self.from_ambient(q)
        return self.squared_distance(p[:, None], q[None, :])

    def check_points(self, name: str, x: np.ndarray, unit: str = "") -> None:
        """Raises ValueError if points `(k, *point_shape)` lie off the manifold."""
        check_on(name, self, x)

    def parts(self, *arrays: Any) -> "list[tuple]":
        """The independent parts: `(label, part, *arrays)`, arrays `(k, *point_shape)` cut
        to each; here one."""
        return [(type(self).__name__, self, *arrays)]

    def tolerance(self, points: Float[np.ndarray, "k s"]) -> float:
        """How far off data may lie; here a millionth of the reach."""
        return by_reach(self, points)

    def mistake(self, points: np.ndarray) -> tuple[Bool[np.ndarray, " k"], str, str]:
        """Which points off the manifold are a mistake with a name, the name (with {} for
        that of the manifold) and the cure; here none."""
        return np.zeros(len(points), bool), "", ""

    def doubt(self, points: np.ndarray) -> str | None:
        """What is odd about points on the manifold, `(k, *point_shape)`, and what may have
        been meant; for a warning, since they may be right. Here nothing."""
        return None
