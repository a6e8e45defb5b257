"""GTSAM's continuous-time trajectories: batch smoothing with a Gaussian process whose
acceleration, in axes of the body, is white noise (Barfoot, Tong and Särkkä 2014; Anderson
and Barfoot 2015)."""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import V, X
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from .tracks import Found, Noisy


def wnoa(data: Noisy, times: np.ndarray) -> Found:
    """The two power spectral densities, rad^2 / s^3 and m^2 / s^3, by marginal
    likelihood (Laplace), noise as it is. States at all `times` follow: of a Markov process
    that is interpolation."""
    guess = np.log([np.var(rates) for rates in _rates(data)])
    best = minimize(
        lambda q: -evidence(data, np.exp(q)),
        guess,
        method="Nelder-Mead",
        options={"xatol": 0.02, "fatol": 0.01, "initial_simplex": _simplex(guess)},
    )
    graph, start = _graph(data, times, np.exp(best.x))
    values = _optimised(graph, start)
    marginals = gtsam.Marginals(graph, values)
    poses = [values.atPose3(X(i)) for i in range(len(times))]
    twists = np.array([values.atVector(V(i)) for i in range(len(times))])
    cov = lambda key: np.array(
        [marginals.marginalCovariance(key(i)) for i in range(len(times))]
    )
    rotations = Rotation.from_matrix([p.rotation().matrix() for p in poses])
    twists[:, 3:] = rotations.apply(twists[:, 3:])
    positions = np.array([p.translation() for p in poses])
    return Found(rotations, positions, twists, cov(X), cov(V), body=True)


def evidence(data: Noisy, q: np.ndarray) -> float:
    """Of the data given the densities, up to a constant, by Laplace's approximation; the
    first state has a flat prior."""
    graph, start = _graph(data, data.times, q)
    values = _optimised(graph, start)
    linear = graph.linearize(values)
    curvature = linear.eliminateSequential().logDeterminant()
    # log determinant of the prior's precision: q^-6 a step for each density
    prior = -(len(data.times) - 1) * 6 * np.sum(np.log(q))
    # logDeterminant is of R, with R^T R the Hessian
    return -graph.error(values) - curvature + 0.5 * prior


def _graph(data: Noisy, times: np.ndarray, q: np.ndarray):
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    density = np.repeat(q, 3)
    states = [gtsam.StateData(X(i), V(i), t) for i, t in enumerate(times)]
    for a, b in zip(states, states[1:]):
        graph.add(gtsam.WnoaMotionFactorPose3(a, b, density))
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat(data.sigma, 3))
    at = np.searchsorted(times, data.times - 1e-6)
    poses = [
        gtsam.Pose3(gtsam.Rot3(r), p)
        for r, p in zip(data.rotations.as_matrix(), data.positions)
    ]
    for i, pose in zip(at, poses):
        graph.add(gtsam.PriorFactorPose3(X(int(i)), pose, noise))
    turn, move = _rates(data)
    after = np.clip(np.searchsorted(at, np.arange(len(times)), "right") - 1, 0, None)
    for i, k in enumerate(after):
        k = min(int(k), len(turn) - 1)
        twist = np.concatenate([turn[k], move[k]])
        span = times[i] - data.times[k]
        start.insert(X(i), poses[k].retract(span * twist))
        start.insert(V(i), twist)
    return graph, start


def _rates(data: Noisy) -> tuple[np.ndarray, np.ndarray]:
    """Body rates between data."""
    dt = np.diff(data.times)[:, None]
    turn = (data.rotations[:-1].inv() * data.rotations[1:]).as_rotvec() / dt
    move = data.rotations[:-1].inv().apply(np.diff(data.positions, axis=0)) / dt
    return turn, move


def _optimised(graph, start):
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(50)
    return gtsam.LevenbergMarquardtOptimizer(graph, start, parameters).optimize()


def _simplex(guess: np.ndarray) -> np.ndarray:
    return guess + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
