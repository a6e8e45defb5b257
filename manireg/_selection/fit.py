"""The one-call path."""

from typing import Any, Literal

from .._input.numbers import Numbers
from .._objective.problem import make_problem
from .._solver.geodesic_loss import solve_geodesic
from .._solver.model import RegressionMap
from .._solver.solve import solve
from .._source import AbstractSource
from ..manifolds import AbstractManifold
from .cross_validate import cross_validate


def fit(
    source: AbstractSource,
    target: AbstractManifold,
    x: Numbers,
    y: Numbers,
    lam: Numbers | None = None,
    *,
    weights: Numbers | None = None,
    centres: int | None = None,
    degree: int | None = None,
    width: float | None = None,
    graded: bool = False,
    tension: float = 0.0,
    loss: Literal["chord", "geodesic"] = "chord",
    **options,
) -> RegressionMap:
    r"""Learn a smooth map `source -> target` from pairs (x_i, y_i):

    $$\min_\Psi \; \frac{\sum_i w_i d_N(y_i, \Psi(x_i))^2}{\sum_i w_i}
    + \lambda \int_M |\nabla d\Psi|^2$$

    **Arguments:** `source`, `target`, `x`, `y`, `weights`, `centres`, `degree`, `width`,
    `graded`, `tension` as in `make_problem`; `lam` lambda, or None to choose it by
    `cross_validate`; other options go to `solve` (with `lam`) or `cross_validate`
    (without).

    - `loss`: on a `PointCloud`, d_N is the chord (default: fast, right to third order) or
      the length of the shortest curve (`"geodesic"`, a few solves more, for data far from
      the map; `lam` has to be given). Other targets have d_N as it is.

    **Returns:** a `RegressionMap`: call it on new points; `.energies`, `.lam`,
    `.result`, `.stats`.

    Source: F. Steinke, M. Hein, Non-parametric Regression Between Manifolds, NIPS 2008.
    """
    data: dict[str, Any] = {
        "weights": weights,
        "centres": centres,
        "degree": degree,
        "width": width,
        "graded": graded,
        "tension": tension,
    }
    if loss not in ("chord", "geodesic") or (loss == "geodesic" and lam is None):
        raise ValueError(
            f"loss: expected 'chord' or, with a given `lam`, 'geodesic'; found {loss!r}."
        )
    if lam is None:
        return cross_validate(source, target, x, y, **data, **options).model
    minimise = solve_geodesic if loss == "geodesic" else solve
    return minimise(make_problem(source, target, x, y, **data), lam, **options)
