"""Choice of the order of the energy: like that of lambda, by what is predicted best."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

from .._input.numbers import Numbers
from .._objective.problem import Problem
from .._solver.minimum import is_successful
from .._sources.data import TooFewInputs
from .._sources.orders import highest_order, least_order
from .choice import CrossValidation
from .given import problem_and_lams

Order = int | Sequence[int] | str
# Those of them that the manifolds allow. Of 72 curves on the sphere, of no benchmark and
# with noise of all sizes, the error is 1.13 times the least of any order and lambda
# (geometric mean), of order 2 alone 1.22, of 3 1.13, of 4 1.31, of 2 and 3 1.11; in the
# first experiment of the paper, where data are dense and precise, 4 is needed.
AUTO = 2, 3, 4


def over_orders(
    choose: Callable[[Problem, Numbers | None], CrossValidation],
    source: Any,
    target: Any,
    x: Numbers,
    y: Numbers,
    lams: Numbers | None,
    order: Order,
    **options: Any,
) -> CrossValidation:
    """`choose(problem, lams)` of the problem of each order, made with these data and
    options; of several that whose criterion is lowest where it is best - of those whose
    map of all data is a minimum, if any is - with the `paths` of all."""
    orders = orders_of(order, source, target)

    def path(p: int) -> CrossValidation:
        return choose(*problem_and_lams(source, target, x, y, lams, order=p, **options))

    if len(orders) == 1:
        return path(orders[0])
    if lams is not None:
        raise ValueError(
            "lams: lambda has a unit of its own for each order; leave the grid out, or "
            "give one order."
        )
    paths: dict[int, CrossValidation] = {}
    for p in orders:
        try:
            paths[p] = path(p)
        except TooFewInputs:
            if order != "auto" or not paths:
                raise
    minima = [cv for cv in paths.values() if is_successful(cv.model.result)]
    best = min(minima or paths.values(), key=lambda cv: float(cv.criterion[cv.chosen]))
    others = {p: cv for p, cv in paths.items() if p != best.order}
    return dataclasses.replace(best, others=others)


def orders_of(order: Order, source: Any, target: Any) -> tuple[int, ...]:
    """Those to be tried, ascending."""
    if isinstance(source, Problem) or isinstance(order, int):
        return (order,)  # type: ignore[return-value]
    if order == "auto":
        least, highest = least_order(source), highest_order(source, target)
        return tuple(p for p in AUTO if least <= p <= highest) or (least,)
    if isinstance(order, str) or len(order) == 0:
        raise ValueError(
            f"order: expected 1, 2, 3, 4, several of these or 'auto', found {order!r}."
        )
    return tuple(sorted(set(order)))
