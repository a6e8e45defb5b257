"""Our times over those of a peer in the same run: what the gate compares."""

import equinox as eqx
import jax
import numpy as np
from _heads.methods import nricp
from _timing import first_and_best
from scipy.interpolate import make_smoothing_spline

import manireg as mr

from .problems import Setup, curve

FITS = 200


def curve_ratios() -> dict[str, float]:
    setup = curve()
    problem = setup.problem()
    lams = mr.lambda_grid(problem)
    ours, every = (
        first_and_best(
            lambda given=given: (
                mr.cross_validate(
                    *setup[:4], given, centres=setup.centres, progress=False
                ).scores
            ),
            3,
        )[1]
        for given in (None, lams)
    )
    chosen = first_and_best(
        lambda: mr.leave_one_out(*setup[:4], progress=False).scores, 3
    )[1]
    scipys = first_and_best(
        lambda: _scipy_cross_validation(setup, np.asarray(lams)), 3
    )[1]
    noise = 0.03 * jax.random.normal(jax.random.key(0), (FITS, *problem.y.shape))
    ys = setup.target.project(problem.y + noise)

    def fit(y, problem):
        noisy = eqx.tree_at(lambda p: p.y, problem, y)
        return mr.solve(noisy, setup.lam, starts=(1.0,), throw=False).coefficients

    one = eqx.filter_jit(fit)
    lanes = eqx.filter_jit(eqx.filter_vmap(fit, in_axes=(0, None)))
    loop = first_and_best(lambda: [one(y, problem) for y in ys], 1)[1]
    vmapped = first_and_best(lambda: lanes(ys, problem), 1)[1]
    spread = first_and_best(lambda: mr.sweep(fit, ys, problem), 1)[1]
    print(f"one warm fit, two starts: {1e3 * _one_fit(setup, problem):.1f} ms")
    print(
        f"cross-validation, default grid: {ours:.2f} s; all {FITS} fits: {every:.2f} s; "
        f"scipy's splines: {scipys:.2f} s"
    )
    return {
        "lambda chosen / scipy's": chosen / scipys,
        "cross-validation / scipy's": ours / scipys,
        f"cross-validation, all {FITS} fits / scipy's": every / scipys,
        f"vmap of {FITS} fits / a loop": vmapped / loop,
        f"sweep of {FITS} fits over {len(jax.devices())} devices / a loop": spread
        / loop,
    }


def _one_fit(setup: Setup, problem: mr.Problem) -> float:
    return first_and_best(lambda: mr.solve(problem, setup.lam).coefficients, 5)[1]


def _scipy_cross_validation(setup: Setup, lams: np.ndarray) -> np.ndarray:
    """A smoothing spline for each coordinate, over the same folds and lambdas."""
    order = np.argsort(setup.x)
    x, y = np.asarray(setup.x)[order], np.asarray(setup.y)[order]
    fold = np.asarray(jax.random.permutation(jax.random.key(0), len(x))) % 10
    scores = np.zeros((10, len(lams)))
    for f in range(10):
        inside = fold != f
        for i, lam in enumerate(lams):
            spline = make_smoothing_spline(x[inside], y[inside], lam=lam * inside.sum())
            p = spline(x[~inside])
            p /= np.linalg.norm(p, axis=1, keepdims=True)
            scores[f, i] = np.mean(np.arccos(np.clip(np.sum(p * y[~inside], 1), -1, 1)))
    return scores


def head_ratios() -> dict[str, float]:
    """Registration with a given lambda against trimesh's nricp_sumner on the same pair."""
    pair = mr.datasets.heads("ict", 0)
    ours = first_and_best(
        lambda: (
            mr.register(
                pair.source,
                pair.target,
                pair.source_landmarks,
                pair.target_landmarks,
                1e-2,
            ).vertices
        ),
        1,
    )
    theirs = first_and_best(lambda: nricp(pair, "sumner"), 1)
    print(
        f"head: {ours[0]:.1f} s, warm {ours[1]:.1f} s; nricp_sumner {theirs[1]:.1f} s"
    )
    return {"head / nricp_sumner": ours[1] / theirs[1]}
