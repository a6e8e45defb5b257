"""Normal coordinates: tangent vectors at one point, sent to the manifold by exp."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from jaxtyping import Array, Float

from ..._source import Chart, bounding_box
from .frames import metric_of_chart


def normal_chart(
    manifold: Any, origin: Float[Array, " t"], around: np.ndarray | None
) -> Chart:
    """Those at `origin`, where the first `orthonormal` coordinate of tangent vectors is 0
    and the others are theirs; cut to the data."""
    if around is not None:
        around = manifold.residual(origin, jax.device_put(around))
        around = np.asarray(around)[:, 1:]
    low, high = bounding_box(manifold, around)
    embed = Partial(_from_normal, manifold, origin)
    metric = metric_of_chart(manifold, embed)
    return Chart(low, high, (False,) * manifold.dim, embed, metric)


def _from_normal(manifold, origin, u: Float[Array, " n"]) -> Float[Array, " t"]:
    c = jnp.concatenate([jnp.zeros(1), u])
    return manifold.exp(origin, manifold.from_orthonormal(origin, c))
