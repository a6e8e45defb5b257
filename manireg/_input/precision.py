"""Everything here needs float64, and JAX forgets it from process to process."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree


def as_scalar(value: Any) -> Array:
    """A number as a float64 array `()`, without compiling anything."""
    if isinstance(value, jax.Array):
        return jnp.asarray(value, float)
    return jax.device_put(np.asarray(value, float))


def check_x64(loaded: PyTree = None):
    """Float64 is on, and was on when the arrays of `loaded` were made: one that is
    unpickled in float32 mode stays rounded."""
    if not jax.config.read("jax_enable_x64"):
        raise ValueError(
            "manireg needs float64, but JAX is in float32 mode. Switch it on before the "
            'first JAX call: jax.config.update("jax_enable_x64", True).'
        )
    leaves = (a for a in jax.tree.leaves(loaded) if isinstance(a, jax.Array))
    if any(a.dtype in (jnp.float32, jnp.float16, jnp.bfloat16) for a in leaves):
        raise ValueError(
            f"{type(loaded).__name__}: holds float32 arrays, made or unpickled while JAX "
            "was in float32 mode: half of the digits are lost. Load it again in a program "
            'that begins with jax.config.update("jax_enable_x64", True).'
        )
