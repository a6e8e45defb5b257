"""Regression of a curve on the unit sphere S^n without manireg: smoothing Riemannian
cubics and quintics by multiple shooting, and geodesic regression. Numpy and scipy only."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares


def inner(x, y):
    return np.sum(x * y, axis=-1, keepdims=True)


def unit(x):
    return x / np.sqrt(inner(x, x))


def log(p, q):
    cosine = inner(p, q)
    v = q - cosine * p
    sine = np.sqrt(inner(v, v))
    angle = np.arctan2(sine, cosine)
    return v * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1)


def geodesic(p, v, t):
    """(len(t), n + 1)"""
    speed = np.linalg.norm(v)
    angle = speed * np.asarray(t)[:, None]
    return np.cos(angle) * p + np.sin(angle) * v / speed


def geodesic_regression(x, y):
    """(p, v) that minimise sum_i d^2(y_i, exp_p(x_i v)): tangent v, unit p."""

    def parts(theta):
        p, v = unit(theta[: y.shape[1]]), theta[y.shape[1] :]
        return p, v - (p @ v) * p

    def residual(theta):
        return log(geodesic(*parts(theta), x), y).ravel()

    slope = np.polynomial.polynomial.polyfit(x, y, 1)
    fit = least_squares(residual, slope.ravel(), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return parts(fit.x)


def curvature(x, y, z):
    """R(x, y) z on the unit sphere."""
    return inner(y, z) * x - inner(x, z) * y


def _flow(state):
    """Of (g, v, D_t v, D_t^2 v, ...), 2 p of them; for the last
    D_t^3 v = -R(D_t v, v) v, or D_t^5 v = R(D_t^2 v, D_t v) v - R(D_t^3 v, v) v."""
    g, v, *derivatives = np.moveaxis(state, -2, 0)
    if len(derivatives) == 2:
        last = -curvature(derivatives[0], v, v)
    else:
        a, b, c = derivatives[:3]
        last = curvature(b, a, v) - curvature(c, v, v)
    rates = [
        w - inner(u, v) * g for u, w in zip([v, *derivatives], [*derivatives, last])
    ]
    return np.stack([v, *rates], axis=-2)


def _advance(states, lengths, fractions=(1.0,)):
    """States (..., 2 p, n + 1) after these fractions of these lengths of time (...); all
    trajectories in one system."""
    lengths = lengths[..., None, None]
    solution = solve_ivp(
        lambda _, s: (lengths * _flow(s.reshape(states.shape))).ravel(),
        (0.0, 1.0),
        states.ravel(),
        method="DOP853",
        t_eval=fractions,
        rtol=1e-11,
        atol=1e-13,
    )
    return solution.y.T.reshape(-1, *states.shape)


def smoothing_spline(x, y, lam, times, order=2):
    """Values at `times` of the curve g on [0, 1] that minimises
    (1/k) sum d^2(y_i, g(x_i)) + lam int |D_t^{p-1} g'|^2, p the order, 2 or 3
    (mathematics.md 5.4): the flow above between the knots x_i, where the last derivative
    jumps by (-1)^p Log_g(y_i) / (k lam); the last p vanish at 0 and 1. Newton from the
    geodesic regression, down in lambda."""
    k, d = y.shape
    rows_of_state = 2 * order
    n = rows_of_state * d
    edges = np.concatenate([[0.0], x, [1.0]])
    lengths = np.diff(edges)
    p, v = geodesic_regression(x, y)
    speed = np.linalg.norm(v)
    at = geodesic(p, v, edges[:-1])
    ahead = speed * geodesic(p, v, edges[:-1] + np.pi / 2 / speed)
    states = np.stack([at, ahead] + [0 * at] * (rows_of_state - 2), axis=1)

    def ends_of(states, lam):
        ends = _advance(states, np.broadcast_to(lengths, states.shape[:-2]))[-1]
        jump = (-1) ** order * log(ends[..., :-1, 0, :], y) / (k * lam)
        ends[..., :-1, -1, :] += jump
        return ends

    h, identity, free = 1e-6, np.eye(n), order * d
    nudges = h * identity.reshape(n, 1, rows_of_state, d)
    for stage in np.geomspace(max(1.0, lam), lam, 12):
        for _ in range(40):
            changed = ends_of(states + np.concatenate([nudges, -nudges]), stage)
            slopes = (changed[:n] - changed[n:]).reshape(n, k + 1, n) / (2 * h)
            ends = ends_of(states, stage)
            g, v = states[0, :2]
            rows = np.zeros(((k + 1) * n + 2, (k + 1) * n))
            for i in range(k):  # the end of a segment is the start of the next
                rows[i * n : (i + 1) * n, i * n : (i + 1) * n] = slopes[:, i].T
                rows[i * n : (i + 1) * n, (i + 1) * n : (i + 2) * n] = -identity
            rows[k * n : -2 - free, :n] = identity[free:]
            rows[-2 - free : -2, k * n :] = slopes[:, k, free:].T
            rows[-2, :d], rows[-1, : 2 * d] = 2 * g, np.concatenate([v, g])
            gaps = [ends[:-1] - states[1:], states[0, order:], ends[-1, order:]]
            gauge = np.array([g @ g - 1, g @ v])
            residual = np.concatenate([*(gap.ravel() for gap in gaps), gauge])
            step = np.linalg.lstsq(rows, -residual, rcond=None)[0].reshape(states.shape)
            size = np.max(np.abs(step[:, 0]))
            states = states + step * min(1.0, 0.2 / size)
            if size < 1e-9:
                break
        else:
            raise RuntimeError(f"shooting failed at lambda {stage}")

    segment = np.searchsorted(edges, times) - 1
    curve = []
    for t, i in zip(times, segment, strict=True):
        length = np.array(t - edges[i])
        curve.append(_advance(states[i], length)[-1][0])
    return np.array(curve)
