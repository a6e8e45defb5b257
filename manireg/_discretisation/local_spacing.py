"""How densely the data lie: the spacing h(x) that centres follow where data cluster."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from .spacing import NEIGHBOURS, ball_spacings

# More data than in an even spread, and in how many places: no random uniform sample of 30
# or more in 4,000 has it.
DENSE, SHARE = 5.0, 0.05
FEWEST = 3  # neighbours that few data are judged by
# Growth of h per distance. Supports reach 2.2 to 2.5 spacings: far centres must not reach
# all of a cluster. In dimension 3 a slow growth costs too many centres.
GROWTH = {1: 0.3, 2: 0.35}
STEEPEST = 0.45
SITES = 32  # nearest sites looked at


class LocalSpacing(NamedTuple):
    """h(x) = min_i (s h_i + c |x - x_i|), at most `largest`: s times the spacing of the
    data next to them, growing away from them at the rate c."""

    sites: Float[np.ndarray, "k s"]
    spacings: Float[np.ndarray, " k"]
    growth: float
    largest: float
    data_volume: float
    """What the data fill, were all as dense as the median one."""
    scale: float = 1.0

    def at(self, scale: float) -> "LocalSpacing":
        return self._replace(scale=scale)

    def __call__(self, points: Float[np.ndarray, "n s"]) -> Float[np.ndarray, " n"]:
        near = min(SITES, len(self.sites))
        distance, index = KDTree(self.sites).query(points, k=near)
        spacing = self.scale * self.spacings[index] + self.growth * distance
        return np.minimum(np.min(spacing, axis=1), self.largest)


def spacings_of(data: Float[np.ndarray, "k s"], m: int) -> Float[np.ndarray, " k"]:
    """Spacing h_i of distinct data around each of them: the ball that holds the q nearest
    has q times the volume h^m; q is eight, for fewer than 24 data a third of them."""
    neighbours = int(np.clip(len(data) // 3, FEWEST, NEIGHBOURS))
    neighbours = min(neighbours, len(data) - 1)
    radius = KDTree(data).query(data, k=neighbours + 1)[0][:, -1]
    return ball_spacings(radius, neighbours, m)


def clustered_spacing(
    data: Float[np.ndarray, "k s"], m: int, volume: float, n: int, coarsest: int
) -> LocalSpacing | None:
    """The spacing that `n` centres should follow, or None where those spread evenly over
    the `volume` serve: unless a twentieth of the distinct data (at least q + 1) lie five
    times as densely as all would on average, and more densely than the centres.
    `coarsest`: so many centres, evenly spread, have the largest spacing."""
    data = np.unique(data, axis=0)
    spacings = spacings_of(data, m)
    k = len(data)
    dense = spacings**m < min(volume / (DENSE * k), volume / n)
    data_volume = k * float(np.median(spacings)) ** m
    fewest = min(max(FEWEST, k // 3), NEIGHBOURS) + 1
    if np.sum(dense) < max(fewest, SHARE * k):
        return None
    if k > 2 * n:  # as many as matter, in proportion
        chosen = np.random.default_rng(0).choice(k, 2 * n, replace=False)
        data, spacings = data[chosen], spacings[chosen]
    largest = (volume / min(coarsest, n)) ** (1 / m)
    growth = GROWTH.get(m, STEEPEST)
    return LocalSpacing(data, spacings, growth, largest, data_volume)
