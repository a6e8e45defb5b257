"""Weighted means on a manifold."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..manifolds import AbstractManifold


class _State(NamedTuple):
    mean: Array
    moved: Array
    """Length of the last step, relative to the spread."""
    steps: Array


def frechet_mean(
    target: AbstractManifold,
    points: Float[Array, "k *point_shape"],
    weights: Float[Array, " k"],
    *,
    starts: int = 3,
    rtol: float = 1e-10,
    max_steps: int = 200,
) -> Float[Array, "*point_shape"]:
    r"""A minimiser of $\sum_i w_i d_N(q, y_i)^2$.

    Iterates $q \leftarrow \exp_q(\sum_i w_i \log_q y_i / \sum_i w_i)$ from each of the
    `starts` heaviest points until the step is below `rtol` of the points' spread, or
    `max_steps` times; the lowest sum wins. The minimiser is unique if the points lie in
    a ball of radius less than half the injectivity radius and
    $\pi / (2 \sqrt{\max K})$ (Karcher 1977).

    **Example:**

    ```python
    points = jnp.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    mr.baselines.frechet_mean(mr.Sphere(2), points, jnp.ones(2))  # 0.7071, 0.7071, 0.0
    ```
    """
    share = weights / jnp.sum(weights)
    axes = len(target.point_shape)
    broadcast = share.reshape(-1, *(1,) * axes)
    length = lambda v: jnp.sqrt(jnp.sum(v**2, axis=tuple(range(-axes, 0))))

    def step(state: _State) -> _State:
        logs = target.log(state.mean[None], points)
        update = jnp.sum(broadcast * logs, axis=0)
        spread = jnp.sqrt(jnp.sum(share * length(logs) ** 2))
        moved = length(update) / jnp.maximum(spread, jnp.finfo(float).tiny)
        return _State(target.exp(state.mean, update), moved, state.steps + 1)

    def unfinished(state: _State):
        return (state.moved > rtol) & (state.steps < max_steps)

    def from_start(index):
        start = _State(points[index], jnp.array(jnp.inf), jnp.array(0))
        mean = jax.lax.while_loop(unfinished, step, start).mean
        return mean, jnp.sum(share * target.squared_distance(mean[None], points))

    _, heaviest = jax.lax.top_k(share, min(starts, len(share)))
    means, spreads = jax.vmap(from_start)(heaviest)
    return means[jnp.argmin(spreads)]
