"""`scatter="factor"` of data that have errors in x, too."""

import numpy as np
import pytest

import manireg as mr


@pytest.mark.parametrize("x_error", ["latent", "effective"])
def test_as_without_errors_in_x_where_they_are_tiny(x_error):
    rng = np.random.default_rng(0)
    x, sigma = np.linspace(0, 1, 25), 0.02
    angle = x[:, None] * [1.0, 0.5] + sigma * rng.normal(size=(25, 2))
    y = np.concatenate([angle, np.ones((25, 1))], axis=1)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    data = mr.Interval(0, 1), mr.Sphere(2), x, y, 1e-3
    options = {"sigma": sigma / 3, "scatter": "factor", "centres": 8}
    exact = mr.fit(*data, **options)
    inexact = mr.fit(*data, **options, x_sigma=1e-5, x_error=x_error)
    phi = exact.summary().phi
    assert phi is not None
    assert 4 < phi < 16  # variances are nine times what is said of them
    assert inexact.summary().phi == pytest.approx(phi, rel=1e-3)
    regions = [model.posterior().region([0.3]).theta95 for model in (exact, inexact)]
    np.testing.assert_allclose(*regions, rtol=1e-3)
