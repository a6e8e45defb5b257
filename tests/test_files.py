"""Files of maps, posteriors and registrations: bit for bit, in a fresh process, too."""

import json
import subprocess
import sys
import textwrap

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from helpers import MANIFOLDS, quartic

import manireg as mr
from manireg import _files

X = np.linspace(0, 1, 12)
QUERIES = np.linspace(0, 1, 7)


def there_and_back(value, tmp_path, *own):
    value.save(tmp_path / "saved.npz")
    return mr.load(tmp_path / "saved.npz", *own)


def fitted(target, key):
    """A map of no energy at all."""
    y = jnp.repeat(target.random_points(key, 1), len(X), axis=0)
    problem = mr.make_problem(mr.Interval(0, 1), target, X, y, centres=6)
    return problem, y


def unsolved(target, key):
    """A map into a target, whose coefficients are those of data: what is saved does not
    depend on what minimises."""
    problem, y = fitted(target, key)
    w = jax.random.normal(key, (problem.pattern.size, y[0].size)) * 1e-3
    model = mr.solve(problem_of_line(), 1e-3)
    parts = (problem.source, problem.target, problem.basis, problem.origin, w, problem)
    where = lambda m: (
        m.source,
        m.target,
        m.basis,
        m.origin,
        m.coefficients,
        m.problem,
    )
    return eqx.tree_at(where, model, parts)


def problem_of_line():
    return mr.make_problem(
        mr.Interval(0, 1), mr.Euclidean(1), X, X[:, None] ** 2, centres=6
    )


OWN = {"quartic": quartic, "curve": MANIFOLDS["curve"].function}


@pytest.mark.parametrize("name", MANIFOLDS)
def test_maps_into_every_manifold(name, key, tmp_path):
    model = unsolved(MANIFOLDS[name], key)
    loaded = there_and_back(model, tmp_path, *([OWN[name]] if name in OWN else []))
    assert eqx.tree_equal(loaded, model)
    assert type(loaded.target) is type(model.target)
    np.testing.assert_array_equal(loaded(QUERIES), model(QUERIES))


SOURCES = {
    "circle": mr.Circle(24.0),
    "box": mr.Box([0, 0], [1, 2]),
    "sphere": mr.Sphere(2),
}


@pytest.mark.parametrize("name", SOURCES)
def test_maps_from_other_sources_and_with_other_losses(name, tmp_path):
    rng = np.random.default_rng(0)
    x = {
        "circle": rng.uniform(0, 24, 40),
        "box": rng.uniform(0, 1, (40, 2)),
        "sphere": mr.Sphere(2).project(jnp.array(rng.normal(size=(40, 3)))),
    }[name]
    y = rng.normal(size=(40, 2))
    options = {"loss": mr.Huber(), "sigma": 0.7, "centres": 12}
    model = mr.fit(SOURCES[name], mr.Euclidean(2), x, y, 0.1, **options)
    loaded = there_and_back(model, tmp_path)
    assert eqx.tree_equal(loaded, model)
    np.testing.assert_array_equal(loaded(x), model(x))
    assert str(loaded.summary()) == str(model.summary())


def test_posteriors(tmp_path):
    data = mr.datasets.line_on_sphere(jax.random.key(0), k=30, kappa=100)
    args = mr.Interval(0, 1), mr.Sphere(2), data.x, data.y
    posterior = mr.fit(*args, 1e-5).posterior()
    loaded = there_and_back(posterior, tmp_path)
    ours, theirs = (p.region(QUERIES, simultaneous=True) for p in (posterior, loaded))
    np.testing.assert_array_equal(ours.covariance, theirs.covariance)
    assert ours.radius == theirs.radius


def test_registrations(tmp_path):
    ball = mr.load_surface(trimesh.creation.icosphere(subdivisions=2))
    other = trimesh.creation.icosphere(subdivisions=2)
    other.apply_scale([1.0, 1.1, 1.2])
    landmarks = np.arange(0, 160, 12)
    found = mr.register(ball, other, landmarks, landmarks, lam=1e-3)
    loaded = there_and_back(found, tmp_path)
    assert eqx.tree_equal(loaded, found)
    assert loaded.landmark_names == found.landmark_names
    np.testing.assert_array_equal(loaded.mesh(0.5).vertices, found.mesh(0.5).vertices)


class Stretched(mr.AbstractManifold):
    """A manifold of a user's: a line of another unit."""

    unit: jax.Array
    dim = 1
    point_shape = (1,)

    @property
    def reach(self):
        return float("inf")

    @property
    def injectivity_radius(self):
        return float("inf")

    def project(self, p):
        return p

    def tangent_projection(self, p, v):
        return jnp.broadcast_arrays(p, v)[1]

    def second_fundamental_form(self, p, u, v):
        return jnp.zeros_like(p + u + v)

    def squared_distance(self, p, q):
        return jnp.sum((self.unit * (p - q)) ** 2, axis=-1)

    def exp(self, p, v):
        return p + v

    def log(self, p, q):
        return q - p

    def random_points(self, key, n):
        return jax.random.normal(key, (n, 1))


def test_a_manifold_of_the_user_is_given_again(tmp_path):
    line = Stretched(jnp.array(2.0))
    model = mr.fit(mr.Interval(0, 1), line, X, X[:, None], 1e-3)
    loaded = there_and_back(model, tmp_path, line)
    assert loaded.target is line
    np.testing.assert_array_equal(loaded(QUERIES), model(QUERIES))
    with pytest.raises(ValueError, match="made with Stretched, which is not part of"):
        mr.load(tmp_path / "saved.npz")
    with pytest.raises(ValueError, match="Stretched given differs from the one saved"):
        mr.load(tmp_path / "saved.npz", Stretched(jnp.array(3.0)))


def test_files_of_others(tmp_path):
    np.savez(tmp_path / "other.npz", a=np.ones(3))
    (tmp_path / "text.npz").write_text("age,lat,lon")
    np.save(tmp_path / "object.npy", np.array([{}], object), allow_pickle=True)
    for name in ("other.npz", "text.npz", "object.npy"):
        with pytest.raises(ValueError, match="was not written by manireg's `save`"):
            mr.load(tmp_path / name)
    later = json.dumps({"manireg": "9.0", "format": 99, "value": None})
    np.savez(tmp_path / "later.npz", structure=np.array(later))
    with pytest.raises(ValueError, match="format 99, written by manireg 9.0"):
        mr.load(tmp_path / "later.npz")


def test_files_name_nothing_but_ours(tmp_path):
    names = "os:system", "manireg._files:importlib.import_module", "numpy:load"
    values = [{"name": name} for name in names]
    for value in (*values, {"class": "subprocess:Popen", "fields": {}}):
        text = json.dumps({"manireg": "0", "format": _files.FORMAT, "value": value})
        np.savez(tmp_path / "evil.npz", structure=np.array(text))
        with pytest.raises(ValueError, match="is not part of manireg"):
            mr.load(tmp_path / "evil.npz")


def run(code, *args):
    command = [sys.executable, "-c", textwrap.dedent(code), *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_a_fresh_process(tmp_path):
    model = mr.solve(problem_of_line(), 1e-3)
    model.save(tmp_path / "line.npz")
    code = """
        import sys, jax, numpy as np
        jax.config.update("jax_enable_x64", True)
        import manireg as mr
        model = mr.load(sys.argv[1])
        print(np.asarray(model(np.linspace(0, 1, 7))).tobytes().hex())
    """
    done = run(code, tmp_path / "line.npz")
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == np.asarray(model(QUERIES)).tobytes().hex()


def test_float64_that_was_forgotten(tmp_path):
    mr.solve(problem_of_line(), 1e-3).save(tmp_path / "line.npz")
    code = "import sys, manireg as mr; mr.load(sys.argv[1])"
    done = run(code, tmp_path / "line.npz")
    assert 'jax.config.update("jax_enable_x64", True)' in done.stderr
