"""How often regions hold the truth: curves on the sphere and of rotations, and maps from
sphere to sphere, simulated; lambda by restricted likelihood, noise found with the map.

    python benchmarks/coverage.py

Shares of 95 % regions that hold the true map or velocity, averaged over x and over
repetitions, and of bands that hold it everywhere. A small circle (the second rotation of a
polar wander path, 54 degrees long), a spiral (the curve of the first experiment, slowed to
a quarter), a curve of rotations, a bent map of the sphere, an arc in the hyperbolic plane
and ellipses that turn. Writes a table to `--out`;
about two hours on two cores, less with `--repetitions`, `--cases`, `--ks`, `--kappas`.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from tqdm import tqdm

import manireg as mr
from manireg.manifolds._defaults.frames import orthonormal_axes, tangent_frames

SPHERE, ROTATIONS = mr.Sphere(2), mr.SpecialOrthogonal(3)
PLANE, TENSORS = mr.Hyperbolic(2), mr.AffineInvariantSPD(2)
SPIRAL = mr.datasets.LineOnSphere(jnp.zeros(1), jnp.zeros((1, 3)), "polar")


def circle(t: np.ndarray) -> np.ndarray:
    """0.6 degrees a unit about an axis half way between y and z."""
    start = Rotation.from_rotvec([np.radians(70), 0, 0]).apply([0, 0, -1.0])
    turn = np.radians(0.6) * t[:, None] * np.array([0, 1, 1]) / np.sqrt(2)
    return Rotation.from_rotvec(turn).apply(start)


def spiral(t: np.ndarray) -> np.ndarray:
    return np.asarray(SPIRAL.truth(t / 4))


def rotations(t: np.ndarray) -> np.ndarray:
    turn = np.stack([np.sin(3 * t), t**2, np.cos(2 * t)], axis=-1)
    return Rotation.from_rotvec(turn).as_matrix()


def bent(p: np.ndarray) -> np.ndarray:
    """A linear map and a quadratic one, back on the sphere."""
    linear = np.array([[0.9, 0.2, 0], [-0.2, 1, 0.3], [0, 0.1, 0.8]])
    more = np.stack([p[:, 1] * p[:, 2], p[:, 0] ** 2, 0 * p[:, 0]], axis=-1)
    return np.asarray(SPHERE.project(p @ linear.T + 0.3 * more))


def disc(t: np.ndarray) -> np.ndarray:
    """An arc of a circle about the middle of Poincare's disc, in hyperbolic space."""
    angle = 3 * t[:, None]
    return np.asarray(PLANE.from_ball(0.6 * np.hstack([np.cos(angle), np.sin(angle)])))


def tensors(t: np.ndarray) -> np.ndarray:
    """Ellipses that turn and stretch."""
    turn = Rotation.from_rotvec(2 * t[:, None] * np.array([0, 0, 1])).as_matrix()
    axes = np.stack([1 + t, -np.cos(3 * t)], axis=-1)
    return np.einsum("kab,kb,kcb->kac", turn[:, :2, :2], axes, turn[:, :2, :2])


class Case(NamedTuple):
    name: str
    source: mr.AbstractSource
    target: mr.AbstractManifold
    truth: Callable[[np.ndarray], np.ndarray]


CASES = [
    Case("small circle", mr.Interval(0, 90), SPHERE, circle),
    Case("spiral", mr.Interval(0, 1), SPHERE, spiral),
    Case("rotations", mr.Interval(0, 1), ROTATIONS, rotations),
    Case("sphere to sphere", SPHERE, SPHERE, bent),
    Case("hyperbolic plane", mr.Interval(0, 1), PLANE, disc),
    Case("tensors, affine-invariant", mr.Interval(0, 1), TENSORS, tensors),
]


def inputs(case: Case, rng: np.random.Generator, k: int) -> np.ndarray:
    if isinstance(case.source, mr.Interval):
        return np.sort(rng.uniform(*(b[0] for b in case.source.bounds), size=k))
    return np.asarray(SPHERE.project(rng.normal(size=(k, 3))))


def noisy(case: Case, points: np.ndarray, rng, sigma: float) -> np.ndarray:
    """Normal in the tangent space, `sigma` in each direction."""
    if not case.target.isometric:
        frames = tangent_frames(case.target, points)
        v = np.einsum("ktn,kn->kt", frames, sigma * rng.normal(size=frames.shape[::2]))
        return np.asarray(case.target.exp(points, v.reshape(points.shape)))
    v = case.target.tangent_projection(points, sigma * rng.normal(size=points.shape))
    return np.asarray(case.target.project(case.target.exp(points, v)))


def covered(case: Case, k: int, kappa: float, repetitions: int) -> dict[str, float]:
    """Shares, and the mean error."""
    curve = isinstance(case.source, mr.Interval)
    queries = inputs(case, np.random.default_rng(0), 100)
    if curve:
        queries = np.linspace(*(float(b[0]) for b in case.source.bounds), 101)
    truth = case.truth(queries)
    regions, bands, speeds, errors = [], [], [], []
    for repetition in range(repetitions):
        rng = np.random.default_rng([7, repetition])
        x = inputs(case, rng, k)
        y = noisy(case, case.truth(x), rng, kappa**-0.5)
        model = mr.fit(case.source, case.target, x, y, criterion="reml", progress=False)
        post = model.posterior()
        regions.append(post.region(queries).contains(truth))
        band = post.region(queries, simultaneous=True)
        bands.append(np.all(band.contains(truth)))
        gaps = case.target.squared_distance(model(queries), truth)
        errors.append(np.sqrt(np.mean(gaps)))
        if curve:
            speeds.append(held_velocity(case, post, queries))
    return {
        "region": float(np.mean(regions)),
        "band": float(np.mean(bands)),
        "velocity": float(np.mean(speeds)) if curve else np.nan,
        "error": float(np.mean(errors)),
    }


def held_velocity(case: Case, post: mr.Posterior, t: np.ndarray) -> float:
    """Share of the places at which the true velocity lies in its region."""
    found, step = post.velocity(t), 1e-4 * np.ptp(t)
    true = (case.truth(t + step) - case.truth(t - step)) / (2 * step)
    at = np.asarray(post.model(t))
    coordinates = case.target.orthonormal
    gap = coordinates(case.truth(t), true) - coordinates(at, found.value)
    axes = orthonormal_axes(case.target, at, found.frame)
    z = np.einsum("qtn,qt->qn", axes, np.asarray(gap).reshape(len(t), -1))
    squares = np.sum(
        z * np.linalg.solve(found.covariance, z[..., None])[..., 0], axis=1
    )
    return float(np.mean(squares <= chi2.ppf(0.95, z.shape[1])))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    default = Path(__file__).parent / "results"
    parser.add_argument("--out", type=Path, default=default)
    parser.add_argument("--repetitions", type=int, default=200)
    parser.add_argument("--cases", nargs="+", default=[case.name for case in CASES])
    parser.add_argument("--ks", nargs="+", type=int, default=[30, 200])
    parser.add_argument("--kappas", nargs="+", type=float, default=[100.0, 1000.0])
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    mr.cache_programs()
    cells = [
        (case, k, kappa)
        for case in CASES
        for k in options.ks
        for kappa in options.kappas
        if case.name in options.cases and (k > 30 or case.source is not SPHERE)
    ]
    lines = [
        f"95 % regions, {options.repetitions} repetitions: share that holds the truth.",
        "",
        "| truth | k | kappa | region | band | velocity | mean error |",
        "|---|---|---|---|---|---|---|",
    ]
    options.out.mkdir(parents=True, exist_ok=True)
    for case, k, kappa in tqdm(cells):
        found = covered(case, k, kappa, options.repetitions)
        shares = [found[name] for name in ("region", "band", "velocity")]
        cells_of = ["–" if np.isnan(s) else f"{s:.3f}" for s in shares]
        row = [case.name, k, f"{kappa:g}", *cells_of, f"{found['error']:.4f}"]
        lines.append("| " + " | ".join(map(str, row)) + " |")
        (options.out / "coverage.md").write_text("\n".join([*lines, ""]))


if __name__ == "__main__":
    main()
