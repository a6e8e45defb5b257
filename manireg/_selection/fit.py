"""The one-call path."""

from typing import Any, Literal

from .._input.numbers import Numbers
from .._objective.problem import make_problem
from .._solver.geodesic_loss import solve_geodesic
from .._solver.model import RegressionMap
from .._solver.solve import checked, solve
from .._source import AbstractSource
from ..manifolds import AbstractManifold
from .cross_validate import cross_validate
from .leave_one_out import leave_one_out
from .orders import Order
from .scores import STEPS_TO_THE_END


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
    order: Order = 2,
    loss: Literal["chord", "geodesic"] = "chord",
    folds: int | None = None,
    **options,
) -> RegressionMap:
    r"""Learn a smooth map `source -> target` from pairs (x_i, y_i):

    $$\min_\Psi \; \frac{\sum_i w_i d_N(y_i, \Psi(x_i))^2}{\sum_i w_i}
    + \lambda \int_M |\nabla^{p-1} d\Psi|^2$$

    **Arguments:** `source`, `target`, `x`, `y`, `weights`, `centres`, `degree`, `width`,
    `graded`, `tension` as in `make_problem`; `order` p as there (default 2, the Eells
    energy), or without `lam` several, `(2, 3)` or `"auto"`, to choose from; `lam` lambda,
    or None to choose it; other options go to `solve` (with `lam`), `leave_one_out` or
    `cross_validate` (without).

    - `folds`: choose lambda by `cross_validate` with so many folds; default by
      `leave_one_out`, of which one fit a lambda is enough.

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
        "order": order,
    }
    if loss not in ("chord", "geodesic") or (loss == "geodesic" and lam is None):
        raise ValueError(
            f"loss: expected 'chord' or, with a given `lam`, 'geodesic'; found {loss!r}."
        )
    if folds is not None and lam is not None:
        raise ValueError("folds: there is nothing to choose where `lam` is given.")
    if lam is not None and not isinstance(order, int):
        raise ValueError(
            f"order: give one where `lam` is given, found {order!r}; lambda has a unit of "
            "its own for each."
        )
    if lam is None and folds is not None:
        options["folds"] = folds
        return cross_validate(source, target, x, y, **data, **options).model
    if lam is None:
        model = leave_one_out(source, target, x, y, **data, **options).model
        return checked(model, STEPS_TO_THE_END)
    minimise = solve_geodesic if loss == "geodesic" else solve
    return minimise(make_problem(source, target, x, y, **data), lam, **options)
