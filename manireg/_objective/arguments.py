"""A problem as compiled programs see it."""

import equinox as eqx
import jax
import numpy as np
from jaxtyping import ArrayLike, PyTree

from .._programs.sizes import data_bucket, filled
from .._sources.checks import is_concrete
from .noise import Precision
from .problem import Problem


def argument(problem: Problem) -> Problem:
    """The same without what programs do not read, filled up with data of weight 0, so
    that problems of similar size share them. Traced data stay as they are."""
    unread = lambda p: (p.source, p.x, p.noise, p.owner, p.precision)
    bare = Precision(problem.precision.relative, None)
    problem = eqx.tree_at(
        unread, problem, (None, None, None, None, bare), is_leaf=lambda a: a is None
    )
    if not is_concrete(*jax.tree.leaves(problem)):
        return problem
    size = data_bucket(len(problem.y))
    more = lambda a: jax.device_put(filled(a, size))
    weights = np.zeros(size)
    weights[: len(problem.y)] = problem.weights
    terms = [
        (term, jax.tree.map(more, args) if term.place == "data" else args)
        for term, args in problem.terms
    ]
    relative = more(problem.precision.relative)
    changed = more(problem.y), jax.device_put(weights), relative, tuple(terms)
    where = lambda p: (p.y, p.weights, p.precision.relative, p.terms)
    return eqx.tree_at(where, problem, changed)


def of_data(array: ArrayLike, size: int) -> np.ndarray:
    """An array with an entry for each datum, filled up like the problem's."""
    return filled(array, data_bucket(size))


def on_host(tree: PyTree) -> PyTree:
    """Its arrays as NumPy's, for formulas that are not worth a program."""
    return jax.tree.map(np.asarray, tree)
