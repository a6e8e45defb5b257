"""What a lambda is judged by: fits along a path, and what each says of its lambda."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, PyTree

from .._solver.model import RegressionMap


class Fit(NamedTuple):
    """All that was found at one lambda."""

    place: PyTree
    """Where the path goes on from."""
    scores: Float[np.ndarray, " folds"]
    converged: Bool[np.ndarray, " folds"]
    objective: float
    """Of the map of all data; not a number where there is none."""
    found: Any
    """What the score makes its model and its judgement of; None where nothing was
    tried."""


class AbstractScore(eqx.Module):
    """Fits along a path, and how they are judged."""

    @abstractmethod
    def start(self, lam: Float[Array, ""]) -> PyTree:
        """A place from which to fit at `lam`, with no other fit to go on from."""

    @abstractmethod
    def fit(self, lam: Float[Array, ""], place: PyTree) -> Fit:
        """At `lam`, started from the place of a fit next to it."""

    @abstractmethod
    def judged(
        self, lams: Sequence[float], fits: Sequence[Fit]
    ) -> Float[np.ndarray, "folds n"]:
        """Of ascending lambdas what has to have a low mean; infinite where not tried."""

    @property
    @abstractmethod
    def refinements(self) -> int:
        """Lambdas off the grid that may be worth a fit, at most."""

    @abstractmethod
    def better(self, lams: Sequence[float], fits: Sequence[Fit]) -> float | None:
        """One of them, of ascending ones that were tried; or none."""

    @abstractmethod
    def model(self, lam: Float[Array, ""], fits: Sequence[Fit]) -> RegressionMap:
        """The map of all data at `lam`; `fits`: that at the next smaller lambda, if it was
        visited, and last the one at `lam` itself."""
