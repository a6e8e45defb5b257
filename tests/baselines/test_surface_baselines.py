"""Warps of space onto surfaces."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scipy.spatial.distance import cdist

import manireg as mr
from benchmarks._rkhs_warp import rkhs_warp
from benchmarks._rkhs_warp.surface_terms import SurfaceTerms
from benchmarks._rkhs_warp.wu_kernel import centres_around, kernel_matrix, wu
from manireg import baselines
from manireg._discretisation.domain import discretise

RULES: dict[str, Any] = dict(levels=2, samples=200, width=1.2)


def sphere(n):
    return np.asarray(discretise(mr.Sphere(2), n // 16).points)


def bent(x):
    """A smooth deformation of space; sends the unit sphere to a surface near it."""
    return x + 0.1 * np.stack([x[:, 1] * x[:, 2], np.sin(2 * x[:, 0]), x[:, 0] ** 2], 1)


def cloud_of(map, n=1500):
    """The image of the unit sphere."""
    mesh = trimesh.convex.convex_hull(sphere(n))
    return mr.PointCloud.from_mesh(
        trimesh.Trimesh(map(mesh.vertices), mesh.faces, process=False)
    )


@pytest.fixture(scope="module")
def points():
    return sphere(400)


@pytest.fixture(scope="module")
def ball():
    return cloud_of(lambda x: x)


@pytest.fixture(scope="module")
def bent_ball():
    return cloud_of(bent)


def some(points, count=20):
    return points[np.linspace(0, len(points) - 1, count).astype(int)]


# Volume spline


@pytest.mark.parametrize("kernel", ["linear", "thin_plate_spline"])
def test_volume_spline_reproduces_affine_maps(points, kernel):
    matrix = np.array([[1.2, 0.1, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.3, 1.1]])
    affine = lambda x: x @ matrix.T + [1.0, 2.0, 3.0]
    target, x = cloud_of(affine), some(points)
    warp = baselines.volume_spline(points, x, affine(x), target, kernel=kernel)
    np.testing.assert_allclose(warp.deformed, affine(points), atol=1e-11)
    np.testing.assert_allclose(warp.vertices, affine(points), atol=2e-3)


def test_volume_spline_interpolates(points, bent_ball):
    x = some(points)
    warp = baselines.volume_spline(points, x, bent(x), bent_ball)
    np.testing.assert_allclose(warp.ambient(x), bent(x), atol=1e-12)
    assert np.abs(bent_ball.signed_distance(jnp.asarray(warp.vertices))).max() < 1e-3
    np.testing.assert_array_equal(warp(points), warp.vertices)


def test_volume_spline_is_the_biharmonic_spline(points, bent_ball):
    """Of all with sum a = 0 and sum a x = 0, by the block system."""
    x = some(points)
    design = np.concatenate([x, np.ones((len(x), 1))], axis=1)
    system = np.block([[-cdist(x, x), design], [design.T, np.zeros((4, 4))]])
    solution = np.linalg.solve(system, np.concatenate([bent(x), np.zeros((4, 3))]))
    at = np.concatenate([-cdist(points, x), points, np.ones((len(points), 1))], axis=1)
    warp = baselines.volume_spline(points, x, bent(x), bent_ball)
    np.testing.assert_allclose(warp.deformed, at @ solution, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kernel, whole, interior",
    [("linear", 1.037, 0.568), ("thin_plate_spline", 1.589, 0.596)],
)
def test_volume_spline_of_a_head(data_folder, kernel, whole, interior):
    """Against a run of scipy with the closest points of the triangles."""
    head = np.load(data_folder / "ict_heads.npz")
    vertices = head["vertices"].astype(float)
    mesh = trimesh.Trimesh(
        head["target00_vertices"], head["target00_faces"], process=False
    )
    warp = baselines.volume_spline(
        vertices,
        vertices[head["landmarks"]],
        head["target_landmarks"][0],
        mr.PointCloud.from_mesh(mesh),
        kernel=kernel,
    )
    errors = np.linalg.norm(warp.vertices - head["ground_truth"][0], axis=1)
    area, inner = head["vertex_area"], head["interior"]
    assert abs(np.average(errors, weights=area) - whole) < 0.02
    assert abs(np.average(errors[inner], weights=area[inner]) - interior) < 0.02


def test_held_out_errors_leave_landmarks_out(points):
    """With the constant map to the mean."""
    x = some(points, 10)
    fit = lambda x, y: lambda new: np.tile(y.mean(0), (len(new), 1))
    errors = baselines.held_out_errors(fit, x, x)
    expected = np.linalg.norm(x - x.mean(0), axis=1) * 10 / 9
    np.testing.assert_allclose(errors, expected, atol=1e-12)


# Kernel


def test_wu_kernel_is_positive_definite(key):
    """The Gram matrix, and the Fourier transform, 4 pi int r k(r) sin(wr)/w dr."""
    cloud = np.random.default_rng(0).uniform(size=(300, 3))
    assert np.linalg.eigvalsh(kernel_matrix(cloud, cloud, 0.7).toarray())[0] > 1e-6
    r = np.linspace(0, 1, 20_001)
    for frequency in np.linspace(0.5, 60, 50):
        transform = np.trapezoid(r * wu(r) * np.sin(frequency * r), r) / frequency
        assert transform > 0


def test_wu_kernel_is_smooth_and_has_compact_support():
    h = 1e-3
    r = np.array([1 - h, 1, 1 + h])
    assert wu(np.zeros(1)) == 1 and np.all(wu(r)[1:] == 0)
    assert wu(r)[0] < 1e-11  # fourth order at the edge
    # no linear term at the centre
    assert abs(wu(np.array([h]))[0] - (1 - 7 * h**2)) < 1e-8


def test_kernel_matrix_is_the_kernel(points):
    centres = points[::10]
    expected = wu(cdist(points, centres) / 0.8)
    found = kernel_matrix(points, centres, 0.8).toarray()
    np.testing.assert_allclose(found, expected, atol=1e-14)


def test_centres_cover_the_surface_and_hold_the_landmarks(points):
    x = some(points, 7)
    centres = centres_around(x, points, 0.3)
    np.testing.assert_array_equal(centres[:7], x)
    assert cdist(points, centres).min(axis=1).max() <= 0.3
    apart = cdist(centres[7:], centres) + 9 * np.eye(len(centres))[7:]
    assert apart.min() > 0.3


# RKHS warp


def test_rkhs_warp_derivatives(bent_ball, points):
    """Residuals of the surface terms, against finite differences."""
    surface = SurfaceTerms(bent_ball, points, 2.0, 3.0)
    p = np.asarray(bent(points)) + 0.02 * np.sin(9 * points)
    terms = surface.terms(p, 0.7)
    slopes = terms(p, slopes=True)[-1]
    assert np.mean(np.any(slopes, axis=(1, 2))) > 0.9
    for axis, h in enumerate(1e-6 * np.eye(3)):
        difference = (terms(p + h)[0] - terms(p - h)[0]) / 2e-6
        np.testing.assert_allclose(slopes[:, :, axis], difference, atol=1e-7)


def test_rkhs_warp_of_a_surface_to_itself_is_the_identity(points, ball):
    x = some(points)
    warp = rkhs_warp(points, points, x, x, ball, **RULES)
    np.testing.assert_allclose(warp.deformed, points, atol=2e-3)


def test_rkhs_warp_matches_surfaces(points, bent_ball):
    """The surfaces tell more than the landmarks alone."""
    x = some(points)
    warp = rkhs_warp(points, points, x, bent(x), bent_ball, **RULES)
    off = lambda w: np.abs(bent_ball.signed_distance(jnp.asarray(w.deformed))).mean()
    rules: dict[str, Any] = RULES | dict(distance_weight=0.0, normal_weight=0.0)
    blind = rkhs_warp(points, points, x, bent(x), bent_ball, **rules)
    assert off(warp) < 2e-3 and off(warp) < 0.1 * off(blind)
    error = lambda w: np.linalg.norm(w.deformed - bent(points), axis=1).mean()
    assert error(warp) < 0.8 * error(blind)


@pytest.mark.slow
def test_rkhs_warp_does_not_depend_on_the_unit_of_length(points, bent_ball):
    x = some(points)
    there = lambda x: 100 * bent(x) + 30
    warp = rkhs_warp(points, points, x, bent(x), bent_ball, **RULES)
    rules = RULES | dict(width=100 * RULES["width"])
    large = rkhs_warp(100 * points, points, 100 * x, there(x), cloud_of(there), **rules)
    expected = 100 * warp.deformed + 30
    np.testing.assert_allclose(large.deformed, expected, atol=1e-2)


def test_rkhs_warp_meets_landmarks_as_their_weight_grows(points, bent_ball):
    x, gaps = some(points), []
    for weight in (1e3, 1e6):
        warp = rkhs_warp(
            points, points, x, bent(x), bent_ball, landmark_weight=weight, **RULES
        )
        gaps.append(np.linalg.norm(warp.ambient(x) - bent(x), axis=1).mean())
    assert gaps[1] < 1e-2 * gaps[0] and gaps[1] < 1e-4


def test_rkhs_warp_of_landmarks_alone_is_kernel_ridge_regression(points, bent_ball):
    x, weight = some(points), 50.0
    warp = rkhs_warp(
        points,
        points,
        x,
        bent(x),
        bent_ball,
        levels=1,
        width=1.5,
        landmark_weight=weight,
        distance_weight=0,
        normal_weight=0,
        affine=False,
    )
    kernel = wu(cdist(x, x) / 1.5)
    ridge = kernel + len(x) / (2 * weight) * np.eye(len(x))
    alpha = np.linalg.solve(ridge, bent(x) - x)
    expected = points + wu(cdist(points, x) / 1.5) @ alpha
    np.testing.assert_allclose(warp.deformed, expected, atol=1e-6)


# Bad input


def spoiled(x):
    return np.where(np.arange(len(x))[:, None] == 3, np.nan, x)


@pytest.mark.parametrize(
    "change, message",
    [
        (
            lambda v, x, y, t: (v[:, :2], x, y, t),
            r"source_vertices: expected positions",
        ),
        (lambda v, x, y, t: (spoiled(v), x, y, t), "source_vertices: 1 of 400 points"),
        (lambda v, x, y, t: (v, np.arange(20), y, t), r"vertices\[numbers\]"),
        (lambda v, x, y, t: (v, spoiled(x), y, t), "source_landmarks: 1 of 20 points"),
        (lambda v, x, y, t: (v, x, y[1:], t), "target_landmarks: expected 20 points"),
        (
            lambda v, x, y, t: (v, x[:4], y[:4], t),
            "at least 5 pairs are needed, found 4",
        ),
        (lambda v, x, y, t: (v, x * [1, 1, 0], y, t), "all in one plane"),
        (lambda v, x, y, t: (v, x[[0, *range(19)]], y, t), "some occur twice"),
        (lambda v, x, y, t: (v, x, 2 * y, t), "lies 1 off the surface"),
    ],
)
def test_bad_input(points, ball, change, message):
    x = some(points)
    vertices, x, y, target = change(points, x, x, ball)
    with pytest.raises(ValueError, match=message):
        baselines.volume_spline(vertices, x, y, target)
    with pytest.raises(ValueError, match=message):
        rkhs_warp(vertices, points, x, y, target)


@pytest.mark.parametrize(
    "options, message",
    [
        (dict(landmark_weight=-1.0), "landmark_weight: must be 0 or positive"),
        (dict(distance_weight=np.nan), "distance_weight: must be 0 or positive"),
        (dict(levels=0), "levels: at least 1"),
        (dict(samples=5), "samples: at least 10"),
        (dict(width=0.0), "width: must be positive"),
    ],
)
def test_bad_options_of_the_rkhs_warp(points, ball, options, message):
    x = some(points)
    with pytest.raises(ValueError, match=message):
        rkhs_warp(points, points, x, x, ball, **options)


def test_bad_normals_and_kernels(points, ball):
    x = some(points)
    equator = x * [1, 1, 0] / np.linalg.norm(x[:, :2], axis=1, keepdims=True)
    with pytest.raises(ValueError, match="target_landmarks: all in one plane"):
        rkhs_warp(points, points, x, equator, ball)
    with pytest.raises(ValueError, match="source_normals: 400 have no length"):
        rkhs_warp(points, 0 * points, x, x, ball)
    with pytest.raises(ValueError, match="source_normals: expected 400 points"):
        rkhs_warp(points, points[1:], x, x, ball)
    with pytest.raises(ValueError, match="kernel: expected 'linear'"):
        baselines.volume_spline(points, x, x, ball, kernel="cubic")
    with pytest.raises(ValueError, match="smoothing: must be 0 or positive"):
        baselines.volume_spline(points, x, x, ball, smoothing=-1.0)
    with pytest.raises(ValueError, match="x: expected positions"):
        baselines.volume_spline(points, x, x, ball)(x[0])
