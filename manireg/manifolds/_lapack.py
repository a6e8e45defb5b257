"""Decompositions of many small matrices, one after the other on the CPU.

jaxlib 0.10 gives a batch to the threads of XLA's pool and waits for them on one of these.
As many batches at a time as there are threads (two on many machines), and all wait for
each other: the program hangs. Mended in jaxlib 0.11.2; of small matrices a loop costs the
same.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp


def _in_turn(f: Callable, signature: str) -> Callable:
    one_by_one = jax.custom_batching.sequential_vmap(f)
    on_cpu = jnp.vectorize(one_by_one, signature=signature)
    return lambda a: jax.lax.platform_dependent(a, cpu=on_cpu, default=f)


eigh = _in_turn(lambda s: tuple(jnp.linalg.eigh(s)), "(n,n)->(n),(n,n)")
"""Ascending eigenvalues and eigenvectors of Hermitian matrices."""

svd = _in_turn(
    lambda a: tuple(jnp.linalg.svd(a, full_matrices=False)), "(n,p)->(n,q),(q),(q,p)"
)
"""Thin singular value decompositions u, s, v^T."""
