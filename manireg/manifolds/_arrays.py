"""What users hand to a manifold's own methods, as arrays."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._input.numbers import Numbers as Numbers, as_numbers
from ._membership import is_concrete


def as_array(name: str, values: Numbers) -> Float[Array, "..."]:
    """Float64, from numbers of any kind; what JAX traces passes."""
    if is_concrete(values):
        return jnp.asarray(as_numbers(name, values))
    return jnp.asarray(values, float)


def first_index(bad: np.ndarray) -> int | tuple[int, ...]:
    """Where the first True is, in as many indices as there are dimensions."""
    bad = np.atleast_1d(bad)
    index = tuple(int(i) for i in np.unravel_index(np.argmax(bad), bad.shape))
    return index[0] if len(index) == 1 else index
