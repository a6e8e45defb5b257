"""Data that nothing around them explains, before any map is fitted."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import label

SIDE = 2  # neighbours on each side, which a cubic goes through
FAR = 6.0  # of the median size nearby: nine standard deviations in three dimensions
NEARBY = 21  # data that tell how large misfits are here, so that quick manoeuvres pass
CONTEST = 4  # places around a datum in which only the worst is taken at a time
RUN = 3  # outliers in a row; more are a shock, or another path
ROUNDS = 100
LEAST = 12  # data


def outliers(
    t: Float[np.ndarray, " k"], y: Float[np.ndarray, "k n"]
) -> Bool[np.ndarray, " k"]:
    """Which data lie far from the cubic through their four neighbours in time, against
    how far others do, here and in all; the worst first, and those beside it then without
    it. More than three in a row are none: nothing tells which side is right."""
    bad = np.zeros(len(t), bool)
    if len(t) < LEAST:
        return bad
    along = np.argsort(t, kind="stable")
    t, y = t[along], y[along]
    found, least = np.zeros(len(t), bool), _grain(y)
    for _ in range(ROUNDS):
        size = _misfits(t, y, ~found)
        usual = max(np.median(size[~found]), least)
        here = _running_median(np.where(found, usual, size))
        ratio = size / np.maximum(here, usual)
        found &= ratio > FAR  # what looked odd beside another
        ratio[found] = 0.0
        padded = np.pad(ratio, CONTEST)
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * CONTEST + 1)
        worst = (ratio > FAR) & (ratio >= windows.max(axis=1))
        if not worst.any():
            break
        found |= worst
    numbered: Any = label(found)
    runs = numbered[0]
    lengths = np.bincount(runs)
    found &= lengths[runs] <= RUN
    bad[along] = found
    return bad


def _running_median(size: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Of as many at the ends, where a datum has a part in many misfits."""
    width = min(NEARBY, len(size))
    windows = np.lib.stride_tricks.sliding_window_view(size, width)
    start = np.arange(len(size)) - width // 2
    return np.median(windows, axis=1)[np.clip(start, 0, len(windows) - 1)]


def _grain(y: Float[np.ndarray, "k n"]) -> float:
    """The steps that numbers of a file are rounded to: of a body that rests the median
    misfit is nothing, and a step no outlier."""
    steps = (np.diff(np.unique(column)) for column in y.T)
    return max([s.min() for s in steps if len(s)] + [np.finfo(float).tiny])


def _misfits(t, y, kept: Bool[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Distances to the cubics, in units of what independent noise of one size makes."""
    pool, k = np.flatnonzero(kept), len(t)
    count = 2 * SIDE
    place = np.searchsorted(pool, np.arange(k))
    shift = np.arange(count + 1)[None] - SIDE
    start = np.clip(place, SIDE, len(pool) - SIDE - 1)[:, None]
    around = pool[start + shift]  # five, of which the datum itself is one or is over
    own = around == np.arange(k)[:, None]
    own[~own.any(axis=1), -1] = True
    around = around[~own].reshape(k, count)
    u = t[around] - t[:, None]
    width = np.maximum(np.max(np.abs(u), axis=1, keepdims=True), 1e-300)
    powers = (u / width)[:, :, None] ** np.arange(count)
    weights = np.linalg.pinv(powers)[:, 0]  # of the value at the datum
    gap = y - np.einsum("kj,kjn->kn", weights, y[around])
    return np.linalg.norm(gap, axis=1) / np.sqrt(1 + np.sum(weights**2, axis=1))
