"""Regression of a curve on the unit sphere S^n without manireg: smoothing Riemannian
cubics by multiple shooting, and geodesic regression. Numpy and scipy only."""

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


def _flow(state):
    """g' = v, D_t v = a, D_t a = b, D_t b = -R(a, v) v = -(|v|^2 a - <a, v> v)."""
    g, v, a, b = np.moveaxis(state, -2, 0)
    av = inner(a, v)
    rates = [v, a - inner(v, v) * g, b - av * g]
    return np.stack([*rates, -(inner(v, v) * a - av * v) - inner(b, v) * g], axis=-2)


def _advance(states, lengths, fractions=(1.0,)):
    """States (..., 4, n + 1) after these fractions of these lengths of time (...); all
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


def smoothing_cubic(x, y, lam, times):
    """Values at `times` of the curve g on [0, 1] that minimises
    (1/k) sum d^2(y_i, g(x_i)) + lam int |D_t g'|^2 (mathematics.md 5.4): the flow above
    between the knots x_i, where b jumps by Log_g(y_i) / (k lam); a = b = 0 at 0 and 1.
    Newton from the geodesic regression, down in lambda."""
    k, d = y.shape
    n = 4 * d
    edges = np.concatenate([[0.0], x, [1.0]])
    lengths = np.diff(edges)
    p, v = geodesic_regression(x, y)
    speed = np.linalg.norm(v)
    at = geodesic(p, v, edges[:-1])
    ahead = speed * geodesic(p, v, edges[:-1] + np.pi / 2 / speed)
    states = np.stack([at, ahead, 0 * at, 0 * at], axis=1)

    def ends_of(states, lam):
        ends = _advance(states, np.broadcast_to(lengths, states.shape[:-2]))[-1]
        ends[..., :-1, 3, :] += log(ends[..., :-1, 0, :], y) / (k * lam)
        return ends

    h, identity = 1e-6, np.eye(n)
    nudges = h * identity.reshape(n, 1, 4, d)
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
            rows[k * n : -2 - 2 * d, :n] = identity[2 * d :]
            rows[-2 - 2 * d : -2, k * n :] = slopes[:, k, 2 * d :].T
            rows[-2, :d], rows[-1, : 2 * d] = 2 * g, np.concatenate([v, g])
            gaps = [ends[:-1] - states[1:], states[0, 2:], ends[-1, 2:]]
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
