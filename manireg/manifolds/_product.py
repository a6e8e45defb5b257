"""Products of manifolds: several responses at once."""

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float, PRNGKeyArray, ScalarLike

from .._source import Atlas
from ._base import AbstractManifold
from ._membership import is_concrete


class Product(AbstractManifold):
    r"""$N_1 \times \dots \times N_k$ with $d^2 = \sum_i s_i^2 d_i^2$; everything acts
    factor by factor. A point is the factors' points, each times its $s_i$, flattened and
    concatenated, see `join`: so that the embedding is isometric, too.

    **Arguments:** the factors, one after the other: `Product(Sphere(2), Euclidean(1))`;
    `scales`, `(k,)`, positive: $s_i$, where one unit of distance is not worth the same in
    all factors; default 1 each.

    **Raises** ValueError without factors, and for scales that are not one positive number
    a factor.

    **Example:** a metre of the way counts as much as a tenth of a radian.

    ```python
    space = mr.Product(mr.Sphere(2), mr.Euclidean(1), scales=(1.0, 0.1))
    p = space.join(jnp.array([0.0, 0.0, 1.0]), jnp.array([3.0]))  # 4 numbers
    direction, way = space.split(p)
    ```
    """

    factors: tuple[AbstractManifold, ...]
    scales: Float[Array, " k"] | None

    def __init__(self, *factors: AbstractManifold, scales: Any = None):
        self.factors = factors
        self.scales = None if scales is None else jnp.asarray(scales, float)

    def __check_init__(self):
        if not self.factors:
            raise ValueError("Product: at least one factor is needed, found none.")
        if self.scales is None:
            return
        if self.scales.shape != (len(self.factors),):
            raise ValueError(
                f"Product: `scales` must be one number a factor, {len(self.factors)}, "
                f"found shape {self.scales.shape}."
            )
        if is_concrete(self.scales) and not _positive(self.scales):
            raise ValueError(
                f"Product: `scales` must be positive, found {self.scales}."
            )

    @property
    def dim(self) -> int:
        return sum(factor.dim for factor in self.factors)

    @property
    def point_shape(self) -> tuple[int, ...]:
        return (sum(math.prod(factor.point_shape) for factor in self.factors),)

    @property
    def reach(self) -> ScalarLike:
        """The smallest of the factors' reaches, each times its scale."""
        return self._smallest([f.reach for f in self.factors])

    @property
    def injectivity_radius(self) -> ScalarLike:
        """The smallest of the factors' injectivity radii, each times its scale."""
        return self._smallest([f.injectivity_radius for f in self.factors])

    def _smallest(self, radii: list[ScalarLike]) -> ScalarLike:
        each = jnp.stack([jnp.asarray(radius) for radius in radii])
        return jnp.min(each if self.scales is None else self.scales * each)

    def split(self, p: Float[Any, "..."]) -> tuple[Float[Any, "..."], ...]:
        """The factors' points (or vectors), each `(..., *factor.point_shape)`, in the
        units of the factors."""
        parts, start = [], 0
        for i, factor in enumerate(self.factors):
            stop = start + math.prod(factor.point_shape)
            part = p[..., start:stop]
            part = part if self.scales is None else part / self.scales[i]
            parts.append(part.reshape(*p.shape[:-1], *factor.point_shape))
            start = stop
        return tuple(parts)

    def join(self, *parts: Float[Any, "..."]) -> Float[Array, "..."]:
        """The inverse of `split`; leading dimensions broadcast."""
        if len(parts) != len(self.factors):
            raise ValueError(
                f"Product.join: {len(self.factors)} parts are needed, one a factor; "
                f"found {len(parts)}."
            )
        flat = []
        for i, (factor, part) in enumerate(zip(self.factors, parts, strict=True)):
            batch = part.shape[: part.ndim - len(factor.point_shape)]
            part = part.reshape(*batch, math.prod(factor.point_shape))
            flat.append(part if self.scales is None else self.scales[i] * part)
        batch = jnp.broadcast_shapes(*(part.shape[:-1] for part in flat))
        flat = [jnp.broadcast_to(part, (*batch, part.shape[-1])) for part in flat]
        return jnp.concatenate(flat, axis=-1)

    def _each(self, method: str, *points: Array) -> list[Array]:
        parts = zip(*(self.split(p) for p in points), strict=True)
        return [
            getattr(factor, method)(*part)
            for factor, part in zip(self.factors, parts, strict=True)
        ]

    def project(self, p: Float[Array, "..."]) -> Float[Array, "..."]:
        return self.join(*self._each("project", p))

    def tangent_projection(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return self.join(*self._each("tangent_projection", p, v))

    def second_fundamental_form(
        self, p: Float[Array, "..."], u: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return self.join(*self._each("second_fundamental_form", p, u, v))

    def squared_distance(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        each = self._each("squared_distance", p, q)
        if self.scales is not None:
            each = [s**2 * d for s, d in zip(self.scales, each, strict=True)]
        return sum(each, jnp.zeros(()))

    def exp(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return self.join(*self._each("exp", p, v))

    def log(
        self, p: Float[Array, "..."], q: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return self.join(*self._each("log", p, q))

    @property
    def isometric(self) -> bool:
        return all(factor.isometric for factor in self.factors)

    def orthonormal(
        self, p: Float[Array, "..."], v: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return self.join(*self._each("orthonormal", p, v))

    def from_orthonormal(
        self, p: Float[Array, "..."], c: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return self.join(*self._each("from_orthonormal", p, c))

    def residual(
        self, y: Float[Array, "..."], p: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        return self.join(*self._each("residual", y, p))

    def covariant_derivative(
        self, psi: Sequence[Float[Array, "..."]]
    ) -> Float[Array, "..."]:
        parts = zip(*(self.split(row) for row in psi), strict=True)
        each = zip(self.factors, parts, strict=True)
        return self.join(*(factor.covariant_derivative(rows) for factor, rows in each))

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        """Independent random points of the factors."""
        keys = jax.random.split(key, len(self.factors))
        parts = zip(self.factors, keys, strict=True)
        return self.join(*(factor.random_points(k, n) for factor, k in parts))

    def product(
        self, around: np.ndarray | None
    ) -> "Sequence[tuple[AbstractManifold, np.ndarray | None, float]]":
        each = np.ones(len(self.factors)) if self.scales is None else self.scales
        scales = np.asarray(each).tolist()
        if around is None:
            return [(factor, None, s) for factor, s in zip(self.factors, scales)]
        parts = map(np.asarray, self.split(np.asarray(around)))
        flat = [part.reshape(len(part), -1) for part in parts]
        return list(zip(self.factors, flat, scales, strict=True))

    def atlas(self, around: np.ndarray | None) -> Atlas | None:
        """All tuples of charts of the factors, if each factor has charts."""
        atlases = [factor.atlas(x) for factor, x, _ in self.product(around)]
        known = [atlas for atlas in atlases if atlas is not None and not atlas.metric]
        complete = len(known) == len(atlases)
        return _product_atlas(known, self.scales) if complete else None

    def parts(self, *arrays: Any) -> "list[tuple]":
        parts = zip(self.factors, *map(self.split, arrays), strict=True)
        return [
            (f"factor {i}, {label}", *inner)
            for i, (factor, *own) in enumerate(parts)
            for label, *inner in factor.parts(*own)
        ]

    def doubt(self, points: np.ndarray) -> str | None:
        """The first of the factors' doubts."""
        parts = zip(self.factors, self.split(np.asarray(points)), strict=True)
        found = [
            (i, factor.doubt(np.asarray(part)))
            for i, (factor, part) in enumerate(parts)
        ]
        return next((f"factor {i}: {text}" for i, text in found if text), None)


def _positive(scales) -> bool:
    return bool(np.all((np.asarray(scales) > 0) & np.isfinite(np.asarray(scales))))


def _product_atlas(atlases: list[Atlas], scales) -> Atlas:
    picked = np.indices([len(a.lower) for a in atlases]).reshape(len(atlases), -1)
    join = lambda arrays: np.concatenate([a[i] for a, i in zip(arrays, picked)], axis=1)
    in_u = np.cumsum([a.lower.shape[1] for a in atlases])[:-1]
    in_label = np.cumsum([a.labels.shape[1] for a in atlases])[:-1]

    embeds = tuple(a.embed for a in atlases)
    ends = tuple(in_u.tolist()), tuple(in_label.tolist())
    embed = Partial(_embed_each, embeds, *ends, scales)
    lower, upper, labels = (
        join([getattr(a, name) for a in atlases])
        for name in ("lower", "upper", "labels")
    )
    return Atlas(lower, upper, labels, embed)


def _embed_each(embeds, in_u, in_label, scales, u, label):
    each = zip(embeds, jnp.split(u, in_u), jnp.split(label, in_label))
    parts = [embed(v, own) for embed, v, own in each]
    if scales is not None:
        parts = [s * part for s, part in zip(scales, parts, strict=True)]
    return jnp.concatenate(parts)
