"""Whether data lie on a manifold: each factor of a product by its own size."""

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from .._programs.program import evaluated
from .._programs.sizes import at_each

ON_MANIFOLD = 1e-6  # allowed distance of data to a manifold, in its smallest radii
ROUNDING = 64 * np.finfo(float).eps  # of coordinates, passed without another look


def is_concrete(*values) -> bool:
    return not any(isinstance(v, Tracer) for v in values)


def projected(space, points):
    """Closest points: one by one, so that programs do not depend on how many they are
    (nor are compiled again at every call, as loops are outside of `jit`)."""
    if not is_concrete(points, *jax.tree.leaves(space)):
        return _project_traced(space, points)
    return jax.device_put(at_each(_project, space, points))


def _project(space, p):
    return space.project(p)


_project_traced = eqx.filter_jit(_project)


def check_on(name: str, space, points):
    """`points`, `(k, *point_shape)`, lie on the manifold `space`, if that is known."""
    if not is_concrete(*jax.tree.leaves(space)):
        return
    here = np.asarray(points)
    parts = space.parts(here, at_each(_project, space, here) - here)
    for label, part, here, gap in parts:
        _check_near(name, label, part, np.asarray(here), np.asarray(gap))


def _check_near(name, label, space, points, gap):
    flat = points.reshape(len(points), -1)
    distance = np.linalg.norm(gap.reshape(len(points), -1), axis=1)
    largest = np.max(np.abs(flat), initial=0.0)
    off = ~(distance <= ROUNDING * largest)
    if off.any():  # a reach may have to be worked out
        off = ~(distance <= max(ROUNDING * largest, space.tolerance(flat)))
    if not off.any():
        return
    mistaken, mistake, cure = space.mistake(points)
    named = np.flatnonzero(off & mistaken)
    if len(named):
        raise ValueError(
            f"{name}: {len(named)} of {len(points)} {mistake.format(label)} (first at "
            f"index {named[0]}). {cure}"
        )
    first, count = np.flatnonzero(off)[0], f"{off.sum()} of {len(points)}"
    known = distance[np.isfinite(distance)]
    worst = f", up to {known.max():.2g} away" if len(known) else ""
    worst += ", some without a closest point" if len(known) < len(distance) else ""
    raise ValueError(
        f"{name}: {count} points lie off {label} (first at index {first}{worst}); "
        f"normalise them, e.g. with {name} = M.project({name})."
    )


def by_reach(space, flat: np.ndarray) -> float:
    """A millionth of the reach, the smallest radius at which a manifold bends or meets
    itself; for a flat one of the size of the data `(k, s)`."""
    with evaluated():
        reach = float(np.asarray(space.reach))
    if np.isfinite(reach):
        return ON_MANIFOLD * reach
    return ON_MANIFOLD * float(np.sqrt(np.mean(np.sum(flat**2, axis=1))))
