"""What x can live on: the interface of all sources, and the charts they may have. Below
the manifolds, which are sources, too."""

import abc
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from ._input.shown import listed


class Chart(eqx.Module):
    r"""A source as the image of a box of coordinates, $u \mapsto$ `embed(u)`.

    **Arguments:**

    - `lower`, `upper`: `(m,)`, the ends of the coordinates, lower < upper.
    - `periodic`: m truth values: whether both ends of a coordinate are the same place.
    - `embed`: a JAX function from coordinates `(m,)` to ambient coordinates `(s,)`, one
      to one (but for those ends), twice differentiable, with a derivative of rank m
      everywhere: no poles, no tips.

    - `metric`: where lengths are not those of the ambient space, a JAX function from
      coordinates `(m,)` to the metric $g_{ab}$, `(m, m)`.

    Frames, volumes and geodesics follow from the derivatives of `embed` and `metric`.
    **Raises** ValueError if the box is empty or the lengths differ.
    """

    lower: Float[np.ndarray, " _"] = eqx.field(converter=lambda v: _ends(v))
    upper: Float[np.ndarray, " _"] = eqx.field(converter=lambda v: _ends(v))
    periodic: tuple[bool, ...] = eqx.field(converter=lambda v: _answers(v))
    embed: Callable[[Array], Array]
    metric: Callable[[Array], Array] | None = None

    def __check_init__(self):
        sizes = self.lower.shape, self.upper.shape, (len(self.periodic),)
        if len(set(sizes)) > 1:
            raise ValueError(
                "Chart: `lower`, `upper` and `periodic` must have the same length, found "
                f"shapes {sizes[0]}, {sizes[1]} and {sizes[2]}."
            )
        if not np.all(self.lower < self.upper):
            raise ValueError(
                "Chart: `lower` must be below `upper`, found "
                f"{listed(self.lower)} and {listed(self.upper)}."
            )

    def atlas(self) -> "Atlas":
        """Of this chart alone."""
        embed = Partial(_without_label, self.embed)
        metric = None if self.metric is None else Partial(_without_label, self.metric)
        boxes = self.lower[None], self.upper[None], np.zeros((1, 0))
        return Atlas(*boxes, embed, metric)


class Atlas(NamedTuple):
    """Charts that share one formula: u, label -> embed(u, label), on F boxes that together
    cover the source once."""

    lower: np.ndarray
    """`(F, m)`, as `upper`."""
    upper: np.ndarray
    labels: np.ndarray
    """`(F, l)`: what tells the charts apart."""
    embed: Callable[[Array, Array], Array]
    metric: Callable[[Array, Array], Array] | None = None


class AbstractSource(eqx.Module):
    r"""What x lives on: a space M of dimension m in $\mathbb{R}^s$.

    A source of your own subclasses this and gives `dim` (m), `point_shape` (of one x, as
    users write it) and `chart`; `outside` where M ends, `to_ambient` and `from_ambient`
    where x are not themselves ambient coordinates. Everything else follows from these.
    A smooth surface without a chart is an `AbstractManifold`: those are sources by
    themselves, and may bring a `chart`, too.

    **Example:** a lampshade, the part of a cone between two heights.

    ```python
    class Lampshade(mr.AbstractSource):
        dim = 2
        point_shape = (3,)

        def chart(self, around):
            def embed(u):
                angle, z = u
                return z * jnp.array([jnp.cos(angle), jnp.sin(angle), 1.0])

            return mr.Chart([0, 1], [2 * jnp.pi, 2], [True, False], embed)

        def outside(self, x):
            return (x[:, 2] < 1 - 1e-9) | (x[:, 2] > 2 + 1e-9)
    ```
    """

    if TYPE_CHECKING:
        # a type checker would take an `AbstractVar` for an argument of the constructor
        dim: ClassVar[int]
        point_shape: ClassVar[tuple[int, ...]]
    else:
        dim: eqx.AbstractVar[int]
        point_shape: eqx.AbstractVar[tuple[int, ...]]

    @abc.abstractmethod
    def chart(self, around: np.ndarray | None) -> Chart | None:
        """Coordinates of M; None if there are no global ones. `around`: the inputs in
        ambient coordinates, `(k, s)`, that an unbounded source is cut to."""

    def to_ambient(self, x: Float[Any, "k ..."]) -> Float[Any, "k s"]:
        """Ambient coordinates of points `(k, *point_shape)`; here: flattened."""
        return x.reshape(len(x), math.prod(self.point_shape))

    def from_ambient(self, p: Float[Any, "k s"]) -> Float[Any, "k ..."]:
        """The inverse of `to_ambient`, differentiable on M."""
        return p.reshape(len(p), *self.point_shape)

    def outside(self, x: Float[Any, "k ..."]) -> Bool[Any, " k"]:
        """Which points `(k, *point_shape)` lie beyond the ends of M, by more than
        rounding; works under `jit`. Here: none."""
        return np.zeros(len(x), bool)

    @property
    def description(self) -> str:
        """As messages call it."""
        return type(self).__name__

    # What else the library asks. A source of your own can leave it as it is.

    @property
    def linear(self) -> bool:
        """Whether x are coordinates of a convex part of a vector space: straight lines
        are geodesics, and x may be dates."""
        return False

    @property
    def sampled(self) -> "AbstractSource":
        """What is integrated over."""
        return self

    def directions(self, frames, second_forms):
        """Frames `(Q, s, m)` of the directions in which maps are differentiated, and
        second forms `(Q, m, m, s)` of these; given those of `sampled`."""
        return frames, second_forms

    def atlas(self, around: np.ndarray | None) -> Atlas | None:
        """Several charts; here the one of `chart`."""
        chart = self.chart(around)
        return None if chart is None else chart.atlas()

    def product(
        self, around: np.ndarray | None
    ) -> "Sequence[tuple[AbstractSource, np.ndarray | None, float]] | None":
        """The factors of a product, each with the data around it, in its own unit, and
        by how much it is scaled; else None."""
        return None

    def known_points(self, n: int = 0) -> tuple[np.ndarray, np.ndarray] | None:
        """Where M is only known at points: these, `(P, s)`, and the share of each in the
        volume, `(P,)`; at least `n` if there are that many. None where any point of M can
        be found."""
        return None

    def even_points(self, n: int) -> tuple[np.ndarray, np.ndarray] | None:
        """`n` evenly spread points `(n, s)` by a formula, and their shares in the volume;
        None without one."""
        return None

    def exact_rule(self, n: int) -> tuple[np.ndarray, np.ndarray] | None:
        """About `n` points `(Q, s)` and weights that integrate polynomials exactly, where
        there is no chart; None without such a rule."""
        return None

    def random_points(self, key: PRNGKeyArray, n: int) -> Float[Array, "n ..."]:
        raise ValueError(
            f"source: {type(self).__name__} has neither a chart nor random points to "
            "choose from; let its method `chart` return a `mr.Chart`, or make it an "
            "AbstractManifold."
        )

    def squared_distances(
        self, p: Float[Array, "a s"], q: Float[Array, "b s"]
    ) -> Float[Array, "a b"]:
        """Of points in ambient coordinates; here of the chord."""
        return jnp.sum((p[:, None] - q[None, :]) ** 2, axis=-1)

    def check_connected(self) -> None:
        """Raises ValueError if M falls into parts, which no energy holds together."""

    def check_points(self, name: str, x: np.ndarray, unit: str = "") -> None:
        """Raises ValueError if points `(k, *point_shape)` lie outside. `unit`: of
        converted dates."""
        out = np.flatnonzero(self.outside(x))
        if len(out):
            unit = f", in {unit}" if unit else ""
            raise ValueError(
                f"{name}: {len(out)} of {len(x)} points lie outside {self.description} "
                f"(first at index {out[0]}: {listed(x[out[0]])}{unit}); widen it or drop "
                "them."
            )


def itself(u: Array) -> Array:
    """The chart of a box. (One function: what is compiled for it serves all boxes.)"""
    return u


def _without_label(function, u, label):
    return function(u)


def bounding_box(
    source: AbstractSource, coordinates
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Of the data, for a source that is not bounded by itself."""
    if coordinates is None:
        raise ValueError(
            f"{type(source).__name__} is unbounded as a source: pass `around`, the data "
            "points whose bounding box is to be covered."
        )
    coordinates = np.asarray(coordinates)
    lower, upper = coordinates.min(axis=0), coordinates.max(axis=0)
    if not np.all(lower < upper):
        raise ValueError(
            f"{type(source).__name__} as a source is cut to the bounding box of `x`, "
            f"which is empty: all points agree in a coordinate ({lower} to {upper})."
        )
    return lower, upper


def _ends(values) -> np.ndarray:
    return np.atleast_1d(np.asarray(values, float))


def _answers(values) -> tuple[bool, ...]:
    return tuple(map(bool, np.atleast_1d(values)))
