"""Procrustes superimposition and principal components of shapes."""

import numpy as np
import pytest
from scipy.spatial import procrustes
from scipy.spatial.transform import Rotation

from manireg._surfaces.shapes import shape_space

RNG = np.random.default_rng(0)
BASE = RNG.normal(size=(40, 3))


def moved(shapes):
    """Each elsewhere, turned, of another size."""
    n = len(shapes)
    turned = np.einsum("nvi,nji->nvj", shapes, Rotation.random(n, rng=RNG).as_matrix())
    size = RNG.uniform(0.3, 3.0, (n, 1, 1))
    return size * turned + 10 * RNG.normal(size=(n, 1, 3))


def test_one_shape_has_no_variance():
    found = shape_space(moved(np.repeat(BASE[None], 6, axis=0)))
    np.testing.assert_allclose(found.aligned, found.aligned[:1].repeat(6, 0), atol=1e-9)
    assert np.sum(found.variances) < 1e-12 * np.mean(found.sizes) ** 2


def test_two_shapes_as_scipy_has_them():
    """Its disparity, with the second of the best size: 1 - cos^2 of the angle."""
    other = BASE + 0.1 * RNG.normal(size=BASE.shape)
    found = shape_space(moved(np.stack([BASE, other])))
    a, b = (s.ravel() / np.linalg.norm(s) for s in found.aligned)
    assert 1 - (a @ b) ** 2 == pytest.approx(procrustes(BASE, other)[2], rel=1e-6)


def test_a_mode_is_found():
    mode = RNG.normal(size=BASE.shape)
    scores = RNG.normal(size=30)
    found = shape_space(moved(BASE + 0.02 * scores[:, None, None] * mode))
    assert found.variances[0] > 100 * found.variances[1]
    assert abs(np.corrcoef(found.scores[:, 0], scores)[0, 1]) > 0.999
    again = found.mean + np.tensordot(found.scores, found.components, 1)
    np.testing.assert_allclose(again, found.aligned, atol=1e-8 * found.sizes.mean())
    flat = found.components.reshape(len(found.components), -1)
    np.testing.assert_allclose(flat @ flat.T, np.eye(len(flat)), atol=1e-6)
    np.testing.assert_allclose(found.scores.var(axis=0, ddof=1), found.variances)


def test_mirror_images_stay_apart():
    found = shape_space(np.stack([BASE, BASE * [-1, 1, 1]]))
    assert found.variances[0] > 0.01 * found.sizes[0] ** 2
