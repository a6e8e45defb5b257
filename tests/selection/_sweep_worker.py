"""Run by test_sweep.py in processes of its own: `DEVICES PROCESSES RANK PORT`. Prints how
much a sweep over all devices differs from a loop, and a score from a fit by hand."""

import os
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import manireg as mr

devices, processes, rank, port = map(int, sys.argv[1:])
os.environ["XLA_FLAGS"] = "--xla_backend_optimization_level=0"
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", devices)
if processes > 1:
    jax.config.update("jax_cpu_collectives_implementation", "gloo")
    jax.distributed.initialize(f"127.0.0.1:{port}", processes, rank)

assert len(jax.devices()) == devices * processes
X = np.sort(np.random.default_rng(0).uniform(size=9))
noise = 0.2 * np.random.default_rng(1).normal(size=(5, 9, 3))
curve = np.stack([np.cos(3 * X), np.sin(3 * X), X**2], axis=1)
ys = mr.Sphere(2).project(jnp.asarray(curve + noise))
problem = mr.make_problem(mr.Interval(0, 1), mr.Sphere(2), X, ys[0], centres=8)


def fit(lane, problem):
    y, lam = lane
    noisy = eqx.tree_at(lambda p: p.y, problem, y)
    # the map: coefficients have directions that it does not depend on
    return mr.solve(noisy, lam, throw=False)(X)


lams = jnp.array([1e-2, 1e-3, 1e-4, 1e-5, 1e-6])
spread = mr.sweep(fit, (ys, lams), problem)
here = jax.local_devices()[:1]
one_by_one = mr.sweep(fit, (ys, lams), problem, devices=here)
cv = mr.cross_validate(
    mr.Interval(0, 1), mr.Sphere(2), X, ys[0], lams, folds=3, centres=8, progress=False
)
folds = np.asarray(jax.random.permutation(jax.random.key(0), 9)) % 3
held_out = folds == 1
model = mr.fit(
    mr.Interval(0, 1), mr.Sphere(2), X[~held_out], ys[0][~held_out], lams[2], centres=8
)
by_hand = np.mean(np.arccos(np.sum(model(X[held_out]) * ys[0][held_out], axis=1)))
sweep = np.abs(np.asarray(spread) - np.asarray(one_by_one)).max()
print("differences", sweep, abs(float(cv.scores[1, 2]) - by_hand))
