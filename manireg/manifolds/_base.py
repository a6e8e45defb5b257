"""The manifold interface: what a target (or a source) has to be able to do."""

import abc
from typing import TYPE_CHECKING, ClassVar

import equinox as eqx
from jaxtyping import Array, Float, PRNGKeyArray, ScalarLike


class AbstractManifold(eqx.Module):
    r"""A Riemannian manifold N of dimension n, isometrically embedded in a vector space
    of arrays of shape `point_shape` (flattened: $\mathbb{R}^t$).

    Letters: `p`, `q` points (or ambient points near N), `u`, `v` ambient vectors. Every
    method accepts leading batch dimensions, which broadcast: points and vectors are
    `(..., *point_shape)`. All methods are pure and differentiable in JAX.

    A manifold of your own subclasses this and overrides the methods below;
    `manireg.manifolds.second_form_of_projection`, `geodesic_exp` and `shooting_log` turn
    most of them into one line. `manireg.check_manifold` then runs the laws.
    """

    if TYPE_CHECKING:
        # a type checker would take an `AbstractVar` for an argument of the constructor
        dim: ClassVar[int]
        point_shape: ClassVar[tuple[int, ...]]
    else:
        dim: eqx.AbstractVar[int]
        point_shape: eqx.AbstractVar[tuple[int, ...]]

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
