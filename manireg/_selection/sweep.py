"""Many fits at once - folds, lambdas, repetitions, scans - spread over devices."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import PyTree

from .._input.precision import check_x64
from .._programs.program import program

LANES = PartitionSpec("lanes")
REPLICATED = PartitionSpec()


def sweep(
    fit: Callable[[PyTree, Any], PyTree],
    lanes: PyTree,
    shared: Any = None,
    *,
    devices: Sequence[Any] | None = None,
) -> PyTree:
    """`fit(lane, shared)` for every lane, stacked.

    A lane is one entry along the leading axis of all arrays in `lanes`. The lanes of a
    device run one after another in one compiled program: one that has converged costs
    nothing more. Several devices take equal shares; they may belong to several processes
    (`jax.distributed`), each of which calls this with the same arguments and gets all
    results. A CPU counts as one device; to use its cores, before anything else:

        jax.config.update("jax_num_cpu_devices", os.cpu_count())

    **Arguments:**

    - `fit`: traced once; returns arrays. Of a `RegressionMap` return what is needed, such
      as `.coefficients`: source, target and basis would be repeated for every lane.
    - `lanes`: arrays (or a pytree of them) with a common leading axis.
    - `shared`: what is the same for all lanes, such as a problem.
    - `devices`: default `jax.devices()`.

    **Raises** ValueError for float32 mode, and where leading axes differ or there are
    none.

    **Example:** fits of several lambdas, spread over the devices.

    ```python
    data = mr.datasets.polar_wander("india")  # 33 poles: ages, unit vectors
    interval, sphere = mr.Interval(0, 320), mr.Sphere(2)
    problem = mr.make_problem(interval, sphere, data.ages, data.directions)
    fit = lambda lam, problem: mr.solve(problem, lam).coefficients
    mr.sweep(fit, jnp.array([1e2, 1e3]), problem).shape[0]  # 2
    ```
    """
    check_x64()
    lengths = {np.shape(leaf)[:1] for leaf in jax.tree.leaves(lanes)}
    if len(lengths) != 1 or () in lengths:
        raise ValueError(
            f"lanes: arrays with one common leading axis expected, found {lengths}."
        )
    devices = tuple(jax.devices() if devices is None else devices)
    return _sweep(fit, lanes, shared, devices)


@program(most=8)
def _sweep(fit, lanes, shared, devices: tuple[Any, ...]):
    one = lambda lane: fit(lane, shared)
    if len(devices) == 1:
        return jax.lax.map(one, lanes)
    count = len(jax.tree.leaves(lanes)[0])
    # lanes that fill up the shares repeat the first
    index = np.arange(-(-count // len(devices)) * len(devices))
    filled = jax.tree.map(lambda a: a[np.where(index < count, index, 0)], lanes)
    mesh = Mesh(np.array(devices), ("lanes",))
    spread = jax.shard_map(
        lambda lanes: jax.lax.map(one, lanes),
        mesh=mesh,
        in_specs=LANES,
        out_specs=LANES,
        check_vma=False,
    )
    results = spread(filled)
    everywhere = NamedSharding(mesh, REPLICATED)
    gather = lambda a: jax.lax.with_sharding_constraint(a[:count], everywhere)
    return jax.tree.map(gather, results)
