"""Series of the basis functions against JAX's derivatives of their values."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import manireg as mr
from manireg._discretisation.domain import discretise
from manireg._discretisation.jets import jets_of
from manireg._discretisation.local_polynomials import basis_values
from manireg._discretisation.taylor import reciprocal, second_derivative_pairs, times

SOURCES = {
    "interval": mr.Interval(0.0, 2.0),
    "circle": mr.Circle(3.0),
    "torus": mr.Torus(2.0, 0.5),
    "ball": mr.Box([0, 0, 0], [1, 1, 1]),
    "ambient": mr.Ambient(mr.Sphere(2)),
}


@pytest.mark.parametrize("name", SOURCES)
def test_derivatives_of_the_basis(name):
    source, rng = SOURCES[name], np.random.default_rng(0)
    domain = discretise(source, 12)
    x = source.from_ambient(domain.points[rng.integers(len(domain.points), size=30)])
    y = rng.normal(size=(30, 1))
    problem = mr.make_problem(source, mr.Euclidean(1), x, y, centres=12)
    basis = problem.basis
    jets = jets_of(basis, domain.points, domain.frames, domain.second_forms)
    for element, row in rng.integers(jets.index.shape, size=(6, 2)):
        q = int(jets.index[element, row])
        x, frame, form = (
            a[q] for a in (domain.points, domain.frames, domain.second_forms)
        )
        near = jets.columns[element, :: basis.size] // basis.size

        def along(u):
            curve = x + frame @ u + 0.5 * jnp.einsum("a,b,abs->s", u, u, form)
            return basis_values(basis, curve, near)

        zero = jnp.zeros(frame.shape[1])
        first, second = jax.jacfwd(along)(zero), jax.hessian(along)(zero)
        pairs = second_derivative_pairs(len(zero))
        rows = [along(zero), *first.T, *(second[:, a, b] for a, b in pairs)]
        expected = np.stack(rows)
        size = np.abs(expected).max()
        found = jets.matrices[element, row]
        np.testing.assert_allclose(found, expected, atol=1e-12 * size)


def test_products_and_quotients():
    """Of (1 + u + 2 v)(3 - u v) and 1 / (2 + u + u v)."""
    f = np.array([1.0, 1.0, 2.0, 0.0, 0.0, 0.0])
    g = np.array([3.0, 0.0, 0.0, 0.0, -1.0, 0.0])
    np.testing.assert_allclose(times(f, g), [3.0, 3.0, 6.0, 0.0, -1.0, 0.0])
    h = np.array([2.0, 1.0, 0.0, 0.0, 1.0, 0.0])
    np.testing.assert_allclose(reciprocal(h), [0.5, -0.25, 0.0, 0.25, -0.25, 0.0])
