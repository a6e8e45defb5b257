"""Quadrature of products, and what a fit in dimension 3 takes by default."""

import jax.numpy as jnp
import numpy as np
import pytest

import manireg as mr
from manireg._discretisation.domain import discretise

SPHERE, LINE = mr.Sphere(2), mr.Euclidean(1)
TIMES = np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 1]])
SOURCES = {
    "sphere and time": (mr.Product(SPHERE, LINE), TIMES, 27),
    "sphere and circle": (mr.Product(SPHERE, mr.Sphere(1)), None, 27),
    "cylinder": (mr.Product(mr.Sphere(1), LINE), TIMES[:, [0, 1, 3]], 16),
}


@pytest.mark.parametrize("name", SOURCES)
def test_points_a_centre_are_those_of_the_dimension(name):
    source, x, most = SOURCES[name]
    domain = discretise(source, 144, x)
    assert 0.5 * most < len(domain.points) / 144 < 1.5 * most


def test_energy_on_sphere_and_time():
    """|Hess (z t)|^2 = 2 z^2 t^2 + 2 (1 - z^2)."""
    source, x, _ = SOURCES["sphere and time"]
    domain = discretise(source, 144, x)
    energy = mr.eells_energy(source, LINE, lambda p: (p[2] * p[3])[None], domain)
    expected = 4 * np.pi * (2 / 3 / 3 + 2 * 2 / 3)
    assert np.isclose(energy, expected, rtol=2e-3)


def test_few_functions_in_dimension_3():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(300, 4))
    x[:, 3] = rng.random(300)
    x[:, :3] /= np.linalg.norm(x[:, :3], axis=1, keepdims=True)
    problem = mr.make_problem(SOURCES["sphere and time"][0], LINE, x, x[:, :1])
    assert problem.basis.degree == 1
    assert len(problem.basis.centres) < 200
    assert problem.energy_jets.matrices.shape[-1] < 200
    assert jnp.allclose(problem.volume, 4 * np.pi * np.ptp(x[:, 3]), rtol=1e-6)
