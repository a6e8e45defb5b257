"""Natural cubic smoothing splines as dense matrices (Reinsch 1967): the truth for maps of
an interval into R^1 and R^2, with posteriors and likelihoods in closed form."""

import numpy as np
from scipy.linalg import block_diag

import manireg as mr

CENTRES = 160  # so many that the local polynomials are splines to 1e-6


def noisy_wave(k=40, sigma=0.2):
    """x, y and the interval between the outer x, where natural splines end."""
    rng = np.random.default_rng(0)
    x = np.sort(rng.uniform(0, 1, k))
    y = np.sin(6 * x) + sigma * rng.normal(size=k)
    return x, y, mr.Interval(x[0], x[-1])


def bending(x):
    r"""K with $f^\top K f = \int f''^2$ of the natural spline through (x, f)."""
    k, h = len(x), np.diff(x)
    Q, R = np.zeros((k, k - 2)), np.zeros((k - 2, k - 2))
    for j in range(k - 2):
        Q[j : j + 3, j] = 1 / h[j], -1 / h[j] - 1 / h[j + 1], 1 / h[j + 1]
        R[j, j] = (h[j] + h[j + 1]) / 3
        if j < k - 3:
            R[j, j + 1] = R[j + 1, j] = h[j + 1] / 6
    return Q @ np.linalg.solve(R, Q.T)


class Spline:
    r"""Of $\frac{1}{k} \sum_i q_i (y_i - f_i)^2 + \lambda \int f''^2$. `q` are precisions,
    absolute ones for absolute covariances; with matrices (k, n, n) of maps into R^n, in
    the order (i, coordinate). `strength`: k lambda, times the mean of absolute q."""

    def __init__(self, x, q, strength):
        q = np.asarray(q)
        n = 1 if q.ndim == 1 else q.shape[1]
        self.W = np.diag(q) if q.ndim == 1 else np.asarray(block_diag(*q))
        self.null = 2 * n
        self.penalty = strength * np.kron(bending(x), np.eye(n))
        self.H = self.W + self.penalty
        self.covariance = np.linalg.inv(self.H)
        self.smoother = self.covariance @ self.W
        self.edf = np.trace(self.smoother)

    def fitted(self, y):
        return self.smoother @ np.ravel(y)

    def quadratic(self, y):
        """Weighted squared residuals and penalty of the minimum."""
        f = self.fitted(y)
        r = np.ravel(y) - f
        return r @ self.W @ r, f @ self.penalty @ f

    def deviance(self, y):
        """Minus twice the restricted log likelihood, up to what does not depend on q or
        the strength: every q has to be positive."""
        log = lambda values: np.sum(np.log(values))
        prior = np.linalg.eigvalsh(self.penalty)[self.null :]
        determinants = log(np.linalg.eigvalsh(self.H)) - log(prior)
        return sum(self.quadratic(y)) + determinants - log(np.linalg.eigvalsh(self.W))
