"""Everything public goes through pickle, deepcopy and into other processes."""

import copy
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
import trimesh
from helpers import MANIFOLDS

import manireg as mr
from manireg._discretisation.domain import discretise

BALL = trimesh.creation.icosphere(subdivisions=2)
CLOUD = mr.PointCloud.from_mesh(BALL)
ANGLE = np.linspace(0, 2 * np.pi, 40, endpoint=False)
CIRCLE = mr.PointCloud(*2 * [np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1)])
X = np.linspace(0, 1, 12)
Y = np.stack([np.cos(2 * X), np.sin(2 * X)], axis=1)


def same(a, b):
    assert type(a) is type(b)
    assert eqx.tree_equal(a, b)


@pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda a: pickle.loads(pickle.dumps(a))]
)
def test_copies(copied):
    sources = [mr.Interval(0, 1), mr.Box([0, 0], [1, 2]), mr.Ambient(CLOUD)]
    clouds = [CLOUD, CIRCLE, CIRCLE.padded(60), CLOUD.patches(jnp.arange(3))]
    domain = discretise(CLOUD, 5)
    curve = mr.Geodesic(CLOUD.points, jnp.ones(()), CLOUD.points[0], jnp.array(True))
    for value in (*MANIFOLDS.values(), *sources, *clouds, domain, curve):
        same(copied(value), value)
    p = jnp.array([[0.3, 0.4, 1.2]])
    np.testing.assert_array_equal(copied(CLOUD).project(p), CLOUD.project(p))


@pytest.fixture(scope="module")
def fitted():
    """A problem, a map into a point cloud, the choice of a lambda, a registration."""
    problem = mr.make_problem(mr.Interval(0, 1), CIRCLE, X, Y, centres=8)
    model = mr.solve(problem, 1e-3, throw=False)
    lams, one = model.lam[None], jnp.ones(1)
    scores, converged = jnp.ones((2, 1)), jnp.ones((2, 1), bool)
    cv = mr.CrossValidation(model.lam, lams, scores, converged, model, one, one, 2)
    ball = mr.load_surface(BALL)
    vertices = np.asarray(BALL.vertices)
    found = mr.Registration(vertices, model, cv, np.ones(5), None, ball, ball)
    poles = mr.apps.Poles([10.0, 20.0], [-80.0, -70.0], [30.0, 40.0], a95=[5.0, 6.0])
    fits = {"problem": problem, "model": model, "cv": cv, "found": found}
    return fits | {"poles": poles}


@pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda a: pickle.loads(pickle.dumps(a))]
)
@pytest.mark.parametrize("name", ["problem", "model", "cv", "found", "poles"])
def test_copies_of_fits(fitted, copied, name):
    same(copied(fitted[name]), fitted[name])
    if name == "model":
        again = copied(fitted["model"])
        np.testing.assert_array_equal(again(X), fitted["model"](X))
        successful = fitted["model"].result == optx.RESULTS.successful
        assert (again.result == optx.RESULTS.successful) == successful


def test_copies_of_a_warp():
    vertices = np.asarray(BALL.vertices)
    places = vertices[:40:2]
    model = mr.baselines.volume_spline(vertices, places, places, CLOUD)
    again = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(again(vertices), model(vertices))


def test_a_worker_that_was_spawned(fitted, monkeypatch):
    """The map itself is what the worker calls."""
    monkeypatch.setenv("JAX_ENABLE_X64", "1")
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        values = pool.submit(fitted["model"], X).result()
    np.testing.assert_allclose(values, fitted["model"](X), atol=1e-14)
