"""Times of warm programs, with what JAX spends on compiling counted apart."""

import time
from collections.abc import Callable
from typing import Any

import jax


class Stopwatch:
    """Calls functions, and keeps an eye on what JAX reports as spent on tracing, lowering
    and compiling."""

    def __init__(self):
        self._compiling = 0.0
        jax.monitoring.register_event_duration_secs_listener(self._listen)

    def _listen(self, event: str, duration_secs: float, **_):
        if event.startswith("/jax/core/compile/"):
            self._compiling += duration_secs

    def __call__(self, function: Callable, *inputs, **keywords):
        """Result, seconds without compilation, seconds of compilation."""
        before, start = self._compiling, time.perf_counter()
        result = function(*inputs, **keywords)
        jax.block_until_ready(jax.tree.leaves(result))
        compiled = self._compiling - before
        return result, time.perf_counter() - start - compiled, compiled


def first_and_best(function: Callable[[], Any], repeats: int) -> tuple[float, float]:
    """Seconds of the first call and the least of the others."""
    times = []
    for _ in range(1 + repeats):
        start = time.perf_counter()
        jax.block_until_ready(jax.tree.leaves(function()))
        times.append(time.perf_counter() - start)
    return times[0], min(times[1:])
