"""Bands around paths on the sphere, as shapes on the paper."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

RIM = 33  # points along the rim of the globe where a region is cut off


def spread_along(
    inputs: Float[np.ndarray, " n"], path: Float[np.ndarray, "n 3"], count: int
) -> Float[np.ndarray, " count"]:
    """`count` of the inputs, as evenly in them as along the path."""
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    both = (inputs - inputs[0]) / np.ptp(inputs) + length / max(length[-1], 1e-12)
    return np.interp(np.linspace(0, both[-1], count), both, inputs)


def envelope(turned: Float[np.ndarray, "q m 3"]) -> list[Float[np.ndarray, "_ 2"]]:
    """Of the rims of regions, in coordinates right, up, towards the eye: for each two that
    follow each other the hull of both, as far as it is on the near side; no points where
    it is not."""
    pieces = []
    for pair in zip(turned[:-1], turned[1:], strict=True):
        piece = np.zeros((0, 2))
        if max(rim[:, 2].max() for rim in pair) > 0:
            piece = _cut(_hull(np.concatenate(pair)))
        closed = len(piece) > 2
        pieces.append(np.append(piece, piece[:1], axis=0) if closed else piece[:0])
    return pieces


def _hull(points: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "_ 3"]:
    """Convex on the sphere, counter-clockwise: that of logarithms at their middle."""
    middle = np.mean(points, axis=0)
    middle /= np.linalg.norm(middle)
    e1, e2 = np.linalg.svd(middle[None])[2][1:]
    if np.cross(e1, e2) @ middle < 0:
        e1, e2 = e2, e1
    across = np.stack([points @ e1, points @ e2], axis=1)
    sine = np.linalg.norm(across, axis=1, keepdims=True)
    angle = np.arctan2(sine, points @ middle[:, None])
    flat = across * angle / np.where(sine > 0, sine, 1.0)
    try:
        return points[ConvexHull(flat).vertices]
    except QhullError:  # no area
        return points[:0]


def _cut(polygon: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "_ 2"]:
    """On the paper, without what is on the far side; there along the rim."""
    near = polygon[:, 2] >= 0
    if np.all(near):
        return polygon[:, :2]
    kept, on_rim = [], []
    for i in range(len(polygon)):
        p, q = polygon[[i - 1, i]]
        if near[i - 1] != near[i]:
            cross = np.sign(q[2] - p[2]) * (p * q[2] - q * p[2])[:2]
            kept.append(cross / np.linalg.norm(cross))
            on_rim.append(True)
        if near[i]:
            kept.append(q[:2])
            on_rim.append(False)
    found = []
    for i in range(len(kept)):
        if on_rim[i - 1] and on_rim[i]:
            found += _arc(kept[i - 1], kept[i])
        found.append(kept[i])
    return np.array(found).reshape(-1, 2)


def _arc(p: Float[np.ndarray, "2"], q: Float[np.ndarray, "2"]) -> list[np.ndarray]:
    """Between two points of the unit circle, the shorter way."""
    turn = np.arctan2(p[0] * q[1] - p[1] * q[0], p @ q)
    angle = np.arctan2(p[1], p[0]) + turn * np.linspace(0, 1, RIM)[1:-1]
    return list(np.stack([np.cos(angle), np.sin(angle)], axis=1))
