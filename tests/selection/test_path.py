"""The order in which lambdas are visited, and where each fit starts."""

import numpy as np
import pytest
from curves import curve_problem, sphere_data

import manireg as mr
from manireg._selection.choice import choose
from manireg._selection.criteria import vertex
from manireg._selection.path import Leg, downwards, follow, up_and_down
from manireg._selection.scores import AbstractScore, Fit

GRID = [1.0, 2.0, 4.0, 8.0, 16.0]


class Distance(AbstractScore):
    """Log of lambda to `best`; a place is the lambda it was found at, 0 a start."""

    best: float
    visits: list
    lower: tuple[float, ...] = ()
    """Where fits that do not come down from a larger lambda have a lower objective."""

    def start(self, lam):
        return 0.0

    def fit(self, lam, place):
        self.visits.append((float(lam), place))
        off = abs(np.log2(float(lam) / self.best))
        below = place < float(lam) and float(lam) in self.lower
        scores, objective = off + np.array([0.0, 2.2]), 0.5 if below else 1.0
        return Fit(float(lam), scores, np.ones(2, bool), objective, below)

    def judged(self, lams, fits):
        return np.stack([fit.scores for fit in fits], axis=1)

    @property
    def refinements(self):
        return 1

    def better(self, lams, fits):
        return vertex(lams, self.judged(lams, fits).mean(axis=0))

    def model(self, lam, fits):
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
    """And the least once more, afresh."""
    down = [(16, 0), (8, 16), (4, 8), (2, 4), (1, 2)]
    assert visits(downwards(GRID)) == [*down, (1, 0)]


def test_back_up_while_it_is_lower():
    score = Distance(4.0, [], lower=(1.0, 2.0, 8.0))
    fits = follow(score, downwards(GRID), {}, progress=False)
    assert score.visits[5:] == [(1, 0), (2, 1), (4, 2)]
    assert [lam for lam in GRID if fits[lam].found] == [1.0, 2.0]


def test_a_leg_goes_on_from_one_of_its_own_plan():
    assert visits([Leg([4.0]), Leg([2.0], after=4.0)]) == [(4, 0), (2, 4)]


class Found(Exception):
    pass


class Chosen(Distance):
    def model(self, lam, fits):
        raise Found(float(lam))


def chosen(best, **options):
    """The lambda, and those visited beside the grid."""
    score = Chosen(best, [])
    problem = curve_problem(mr.Euclidean(2), sphere_data()[:, :2])
    with pytest.raises(Found) as found:
        choose(problem, score, np.array(GRID), downwards, progress=False, **options)
    return found.value.args[0], [lam for lam, _ in score.visits if lam not in GRID]


def test_the_grid_grows_past_the_edge_where_the_lowest_lies():
    """By a quarter of its range: to half its least value in five steps."""
    assert chosen(4.0, widen=True) == (4.0, [])
    assert chosen(1.0, widen=False) == (1.0, [])
    lam, beyond = chosen(2.0**-9, widen=True)
    np.testing.assert_allclose((lam, min(beyond)), (0.25, 0.25))  # twice
    lam, beyond = chosen(20.0, widen=True)
    assert 19 < lam < 22 and min(beyond) > 16 and max(beyond) == pytest.approx(32)


def test_one_more_between_the_lowest_and_its_neighbours():
    """Of |log2(lam / 5)| the parabola through 2, 4 and 8 has its vertex above 4."""
    lam, (beside,) = chosen(5.0, refine=True)
    assert lam == beside and 4 < lam < 5.7
    assert chosen(4.0, refine=True) == (4.0, [])  # the lowest is the vertex
    assert chosen(1.0, refine=True) == (1.0, [])  # at the edge there is none
