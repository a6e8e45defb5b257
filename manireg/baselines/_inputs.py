"""What the baselines accept as inputs."""

from collections.abc import Callable

from jaxtyping import Array, Float

from .._input.numbers import Numbers
from .._input.precision import check_x64
from .._source import AbstractSource
from .._sources.checks import check_inputs
from ..manifolds import AbstractManifold


def predicted(
    model,
    source: AbstractSource,
    target: AbstractManifold,
    x: Numbers,
    values: Callable[[Float[Array, "n s"]], Float[Array, "..."]],
) -> Float[Array, "..."]:
    """`values` of a fitted model at new inputs, checked as those of `RegressionMap` are;
    for a single point a single one."""
    check_x64(model)
    flat, single = check_inputs(source, x)
    points = values(flat).reshape(-1, *target.point_shape)
    return points[0] if single else points


def only_for(method: str, sources: str, source: AbstractSource) -> ValueError:
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
