"""The order in which lambdas are visited, and where each fit starts."""

import numpy as np
import pytest

from manireg._selection.choice import choose
from manireg._selection.path import Leg, downwards, follow, up_and_down
from manireg._selection.scores import AbstractScore, Fit

GRID = [1.0, 2.0, 4.0, 8.0, 16.0]


class Distance(AbstractScore):
    """Log of lambda to `best`; a place is the lambda it was found at, 0 a start."""

    best: float
    visits: list

    def start(self, lam):
        return 0.0

    def fit(self, lam, place):
        self.visits.append((float(lam), place))
        off = abs(np.log2(float(lam) / self.best))
        return Fit(float(lam), off + np.array([0.0, 2.2]), np.ones(2, bool), None)

    def trimmed(self, scores):
        return scores

    def model(self, lam, fit):
        raise NotImplementedError


def visits(plan, best=4.0, visited={}):
    score = Distance(best, [])
    follow(score, plan, visited, progress=False)
    return score.visits


def test_up_and_down():
    """Each from its neighbour; up and down both from the middle. Means at 4, 8, 16 are
    1.1, 2.1, 3.1: the last is beyond twice the best, and what is above is left out, or
    comes from above."""
    grid = [2.0, 4.0, 8.0, 16.0, 32.0, 64.0]
    hopeful = [(4, 0), (8, 4), (16, 8), (2, 4)]
    assert visits(up_and_down(grid, 3.9, to_the_end=False)) == hopeful
    everything = [*hopeful, (64, 0), (32, 64)]
    assert visits(up_and_down(grid, 3.9, to_the_end=True)) == everything


def test_down_as_far_as_there_is_hope():
    down = [(16, 0), (8, 16), (4, 8)]
    assert visits(up_and_down(GRID, 20.0, to_the_end=False), best=16.0) == down
    down += [(2, 4), (1, 2)]
    assert visits(up_and_down(GRID, 20.0, to_the_end=True), best=16.0) == down


def test_downwards():
    down = [(16, 0), (8, 16), (4, 8), (2, 4), (1, 2)]
    assert visits(downwards(GRID, [])) == down
    nothing = np.zeros(2), np.ones(2, bool), None
    before = {lam: Fit(-lam, *nothing) for lam in GRID}
    assert visits(downwards([0.5], before), visited=before) == [(0.5, -1)]
    assert visits(downwards([32.0], before), visited=before) == [(32, -16)]


def test_a_leg_goes_on_from_one_of_its_own_plan():
    assert visits([Leg([4.0]), Leg([2.0], after=4.0)]) == [(4, 0), (2, 4)]


class Found(Exception):
    pass


class Chosen(Distance):
    def model(self, lam, fit):
        raise Found(float(lam))


def chosen(best, rule):
    """The lambda, and those visited past the edges of the grid."""
    score = Chosen(best, [])
    with pytest.raises(Found) as found:
        choose(
            score, np.array(GRID), downwards, rule,
            widen=True, ratios=np.array([2.0]), progress=False,
        )  # fmt: skip
    return found.value.args[0], [lam for lam, _ in score.visits[len(GRID) :]]


def test_rules_and_edges():
    """The grid grows below the best value, and above the choice. The standard error 1.1
    allows for one step."""
    assert chosen(4.0, "lowest") == (4.0, [])
    assert chosen(4.0, "one standard error") == (8.0, [])
    assert chosen(8.0, "lowest") == (8.0, [])
    assert chosen(8.0, "one standard error") == (16.0, [32.0])
    assert chosen(1.0, "lowest") == (1.0, [0.5])
    assert chosen(1.0, "one standard error") == (2.0, [0.5])
    assert chosen(2.0**-9, "lowest") == (0.25, [0.5, 0.25])
