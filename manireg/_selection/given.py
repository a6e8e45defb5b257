"""What a choice of lambda is given: a problem, or the data of one."""

from inspect import signature
from typing import Any

import numpy as np

from .._input.numbers import Numbers
from .._input.precision import check_x64
from .._objective.make_problem import make_problem
from .._objective.problem import Problem
from .._sources.data import check_distinct
from .._sources.orders import least_inputs
from ..manifolds import AbstractManifold


def problem_and_lams(
    source: Any, target: Any, x: Numbers, y: Numbers, lams: Numbers, **options: Any
) -> tuple[Problem, Numbers]:
    """`make_problem` of the data and options, or the problem given as `source`; after one
    the second argument is `lams`.

    **Raises** ValueError for data or options beside a problem, and for data missing."""
    data = {"target": target, "x": x, "y": y}
    if not isinstance(source, Problem):
        missing = [name for name, value in data.items() if value is None]
        if missing:
            raise ValueError(
                f"{', '.join(missing)}: missing; give source, target, x and y, or a "
                "`Problem` from `make_problem` alone."
            )
        problem = make_problem(source, target, x, y, **options)
        return checked(problem), lams
    check_x64(source)
    if lams is None and not isinstance(target, AbstractManifold):
        lams, data["target"] = target, None
    parameters = signature(make_problem).parameters
    defaults = {name: parameters[name].default for name in options}
    given = [name for name, value in data.items() if value is not None]
    given += [n for n, v in options.items() if not np.array_equal(v, defaults[n])]
    if given:
        raise ValueError(
            f"{', '.join(given)}: a `Problem` has these already; leave them out here, and "
            "give them to `make_problem`."
        )
    return checked(source), lams


def checked(problem: Problem) -> Problem:
    """The problem, if any datum can be left out: of the least inputs that a fit takes all
    are met, whatever lambda.

    **Raises** ValueError."""
    order = problem.energy.order
    least = least_inputs(problem.source, order) + 1
    data = problem.source, problem.x, problem.weights
    check_distinct(*data, least, f"a choice of lambda at order {order}")
    return problem
