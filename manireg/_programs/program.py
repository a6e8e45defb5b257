"""A function compiled once for each structure and shape of its arguments, as by
`equinox.filter_jit`, which keeps what it has compiled for ever: some ten megabytes and a
thousand memory maps for a Newton solve, of which the kernel allows a process 65,530.
Here the programs used longest ago are dropped."""

import contextlib
import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

SMALL = 100e6  # bytes of arguments: a fit to them gains more than it loses by `QUICK`
QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 1}


@functools.cache
def _quickly() -> dict[str, Any]:
    """Those of the compiler's options that halve its time, and cost a tenth of the
    program's, which this version of XLA knows."""
    known = {}
    for name, value in QUICK.items():
        one = jax.jit(lambda x: x, compiler_options={name: value})
        with contextlib.suppress(jax.errors.JaxRuntimeError, ValueError):
            one.lower(0.0).compile()
            known[name] = value
    return known


def evaluated() -> contextlib.AbstractContextManager:
    """Where what is known is computed at once, also inside a function that `jit` traces.
    Elsewhere it is so anyway, and constants of programs would become programs."""
    traced = isinstance(jnp.zeros(()), Tracer)
    return jax.ensure_compile_time_eval() if traced else contextlib.nullcontext()


class _Shape(NamedTuple):
    """Of an array, in the place of which it stands."""

    shape: tuple[int, ...]
    dtype: Any


def program(most: int) -> Callable[[Callable], Callable]:
    """A decorator: compile, and keep the last `most` programs. Arrays are arguments of a
    program; everything else belongs to it, as Python numbers do. Traced arguments are
    passed on, to become a part of the program that is being traced."""

    def decorate(function: Callable) -> Callable:
        inside = eqx.filter_jit(function)

        @functools.lru_cache(most)
        def compiled(tree, leaves: tuple) -> Callable:
            others = []

            def run(arrays):
                filled = iter(arrays)
                args = [next(filled) if _is_shape(a) else a for a in leaves]
                found = function(*jax.tree.unflatten(tree, args))
                found, rest = eqx.partition(found, eqx.is_array)
                others[:] = [rest]
                return found

            small = sum(map(_bytes, leaves)) < SMALL
            # with `run` all goes that JAX keeps for it
            jitted = jax.jit(run, compiler_options=_quickly() if small else None)
            return lambda arrays: eqx.combine(jitted(arrays), others[0])

        @functools.wraps(function)
        def call(*args):
            leaves, tree = jax.tree.flatten(args)
            if any(isinstance(a, Tracer) for a in leaves):
                return inside(*args)
            arrays = [a for a in leaves if _is_array(a)]
            signature = tuple(
                _Shape(a.shape, a.dtype) if _is_array(a) else a for a in leaves
            )
            return compiled(tree, signature)(arrays)

        return call

    return decorate


def _bytes(leaf: Any) -> int:
    if not isinstance(leaf, _Shape):
        return 0
    return math.prod(leaf.shape) * np.dtype(leaf.dtype).itemsize


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray)


def _is_shape(leaf: Any) -> bool:
    return isinstance(leaf, _Shape)
