"""Poles of both polarities, brought to one: an axis is a pole or its opposite."""

import numpy as np
from jaxtyping import Bool, Float

NEIGHBOURS = 9  # poles of similar age whose axis is taken


def opposite(
    age: Float[np.ndarray, " n"], directions: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " n"]:
    r"""Which poles lie more than 90 degrees from the path around them. The path here is
    the axis of largest eigenvalue of $\sum_j w_j p_j p_j^\top$ over the nine poles of
    nearest rank in age, tricube weights, which no polarity changes (Watson 1965,
    Biometrika 52, 193); its sign goes on from age to age. Of the two polarities that of
    most poles stays."""
    n, order = len(age), np.argsort(age, kind="stable")
    sorted_poles, axes = directions[order], np.zeros((n, 3))
    reach = min(NEIGHBOURS, n) / 2 + 0.5
    for i in range(n):
        weights = np.maximum(1 - np.abs((np.arange(n) - i) / reach) ** 3, 0.0) ** 3
        axis = np.linalg.eigh((weights * sorted_poles.T) @ sorted_poles)[1][:, -1]
        before = axes[i - 1] if i else sorted_poles[0]
        axes[i] = axis if axis @ before >= 0 else -axis
    found = np.zeros(n, bool)
    found[order] = np.sum(axes * sorted_poles, axis=1) < 0
    return ~found if found.sum() > n / 2 else found
