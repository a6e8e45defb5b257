"""The first answer, as a newcomer meets it: CPU seconds of a fresh process that fits a
curve, over those of its imports."""

import os
import subprocess
import sys
import time

NAMES = "imports", "first curve", "another curve", "one lambda"


def first_ratios() -> dict[str, float]:
    """Of a curve of 70 data with lambda chosen and 1,000 predictions, of another one of 90
    data, and of one more fit to these at a given lambda, compiled before."""
    settings = os.environ | {"JAX_ENABLE_COMPILATION_CACHE": "false"}
    run = subprocess.run(
        [sys.executable, __file__], env=settings, capture_output=True, check=True
    )
    seconds = dict(zip(NAMES, map(float, run.stdout.split()), strict=True))
    print(", ".join(f"{name}: {value:.2f} s" for name, value in seconds.items()))
    return {
        f"{name} / imports": seconds[name] / seconds["imports"] for name in NAMES[1:]
    }


def _worker() -> None:
    import jax

    jax.config.update("jax_enable_x64", True)
    import numpy as np

    import manireg as mr

    seconds = [time.process_time()]  # of the process, so of the imports
    sphere, interval = mr.Sphere(2), mr.Interval(0.0, 1.0)
    for k in (70, 90):
        track = mr.datasets.line_on_sphere(jax.random.key(k), k, 1000)
        start = time.process_time()
        model = mr.fit(interval, sphere, track.x, track.y, progress=False)
        np.asarray(model(np.linspace(0, 1, 1000)))
        seconds.append(time.process_time() - start)
    for _ in range(2):  # the first one compiles its starts
        start = time.process_time()
        model = mr.fit(interval, sphere, track.x, track.y, 1e-6)
        np.asarray(model.coefficients)
        seconds[3:] = [time.process_time() - start]
    print(*seconds)


if __name__ == "__main__":
    _worker()
