"""Series of the basis functions against JAX's derivatives of their values."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import manireg as mr
from manireg._discretisation.domain import discretise
from manireg._discretisation.jets import jets_of
from manireg._discretisation.local_polynomials import basis_values
from manireg._discretisation.partial_derivatives import partial_derivatives
from manireg._discretisation.taylor import reciprocal, times

SOURCES = {
    "interval": mr.Interval(0.0, 2.0),
    "circle": mr.Circle(3.0),
    "torus": mr.Torus(2.0, 0.5),
    "ball": mr.Box([0, 0, 0], [1, 1, 1]),
    "ambient": mr.Ambient(mr.Sphere(2)),
}


ORDERS = [(name, 2) for name in SOURCES]
ORDERS += [("interval", 4), ("circle", 4), ("torus", 3), ("ambient", 3)]


@pytest.mark.parametrize(("name", "order"), ORDERS)
def test_derivatives_of_the_basis(name, order):
    source, rng = SOURCES[name], np.random.default_rng(0)
    domain = discretise(source, 12, order=order)
    x = source.from_ambient(domain.points[rng.integers(len(domain.points), size=30)])
    y = rng.normal(size=(30, 1))
    problem = mr.make_problem(source, mr.Euclidean(1), x, y, centres=12, order=order)
    basis, geodesics = problem.basis, domain.geodesics(order)
    jets = jets_of(basis, geodesics, order)
    m = domain.dim
    directions = partial_derivatives(m, order)
    for element, row in rng.integers(jets.index.shape, size=(6, 2)):
        q = int(jets.index[element, row])
        near = jets.columns[element, :: basis.size] // basis.size

        def along(u):
            terms = [
                row * jnp.prod(u[jnp.array(d, int)]) / factorials(d)
                for d, row in zip(directions, geodesics[q])
            ]
            return basis_values(basis, jnp.sum(jnp.stack(terms), axis=0), near)

        derivatives = [along]
        for _ in range(order):
            derivatives.append(jax.jacfwd(derivatives[-1]))
        tensors = [f(jnp.zeros(m)) for f in derivatives]
        expected = np.stack([tensors[len(d)][(..., *d)] for d in directions])
        size = np.abs(expected).max()
        found = jets.matrices[element, row]
        np.testing.assert_allclose(found, expected, atol=1e-12 * size)


def factorials(directions):
    return math.prod(math.factorial(directions.count(a)) for a in set(directions))


def test_products_and_quotients():
    """Of (1 + u + 2 v)(3 - u v) and 1 / (2 + u + u v)."""
    f = np.array([1.0, 1.0, 2.0, 0.0, 0.0, 0.0])
    g = np.array([3.0, 0.0, 0.0, 0.0, -1.0, 0.0])
    np.testing.assert_allclose(times(f, g, 2, 2), [3.0, 3.0, 6.0, 0.0, -1.0, 0.0])
    h = np.array([2.0, 1.0, 0.0, 0.0, 1.0, 0.0])
    np.testing.assert_allclose(reciprocal(h, 2, 2), [0.5, -0.25, 0.0, 0.25, -0.25, 0.0])
