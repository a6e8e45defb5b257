"""What the baselines accept as inputs."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .._checks import check_points, is_concrete
from .._sources import Source


def flat_inputs(source: Source, x: ArrayLike) -> Float[Array, "n s"]:
    """New inputs of a fitted model, checked where their values are known."""
    if is_concrete(x):
        return jnp.asarray(check_points("x", source, x))
    return jnp.asarray(x).reshape(np.shape(x)[0], -1)


def only_for(method: str, sources: str, source: Source) -> ValueError:
    return ValueError(
        f"source: {method} is defined for {sources}, found {type(source).__name__}; "
        "manireg.fit takes any source."
    )


def check_choice(value, grid, name: str) -> None:
    """One of a value, a grid of values, or neither."""
    if value is not None and grid is not None:
        raise ValueError(
            f"{name}, {name}s: give a value, or a grid to choose from, not both."
        )
