"""One curve problem for many tests: same shapes, so one compiled solver."""

import numpy as np

import manireg as mr

INTERVAL = mr.Interval(0.0, 1.0)
X = np.array([0.03, 0.17, 0.28, 0.41, 0.52, 0.68, 0.79, 0.96])
CENTRES = 80
TIMES = np.linspace(0.005, 0.995, 67)


def sphere_data(n=2):
    """Noisy values on S^n, in a half sphere."""
    rng = np.random.default_rng(1)
    bend = rng.normal(size=(3, n + 1)) * np.array([[0.3], [2.0], [1.0]])
    bend[0, 0] += 1.5
    y = np.stack([0 * X + 1, X - 0.5, 4 * (X - 0.5) ** 2], axis=1) @ bend
    y += 0.1 * rng.normal(size=y.shape)
    return y / np.linalg.norm(y, axis=1, keepdims=True)


def curve_problem(target, y, **options):
    return mr.make_problem(INTERVAL, target, X, y, centres=CENTRES, **options)
