"""Planar shapes against complex numbers, scipy and the sphere that triangles form."""

# pyright: reportArgumentType=false, reportIndexIssue=false

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.spatial
from scipy.spatial.transform import Rotation

import manireg as mr
from manireg._discretisation.domain import discretise

INTERVAL = mr.Interval(0, 1)
TRIANGLE = np.array([[120.0, 40], [300, 55], [210, 260]])
X = np.sort(np.random.default_rng(0).uniform(size=25))


def configurations(n, k, seed=0, spread=0.4):
    """Landmarks that differ by a curve and by noise, each turned, scaled and moved."""
    rng = np.random.default_rng(seed)
    base, course = rng.normal(size=(2, k, 2))
    t = np.linspace(0, 1, n)[:, None, None]
    landmarks = base + spread * (
        np.sin(4 * t) * course + 0.2 * rng.normal(size=(n, k, 2))
    )
    angles = rng.uniform(0, 2 * np.pi, (n, 1)) * [0, 0, 1]
    turns = Rotation.from_rotvec(angles).as_matrix()[:, :2, :2]
    return rng.uniform(1, 3, (n, 1, 1)) * landmarks @ turns + rng.normal(size=(n, 1, 2))


def complex_preshapes(landmarks):
    z = landmarks[..., 0] + 1j * landmarks[..., 1]
    z = z - z.mean(axis=-1, keepdims=True)
    return z / np.linalg.norm(z, axis=-1, keepdims=True)


def on_sphere(landmarks):
    """Triangles: Hopf's map to the sphere of radius 1/2, times the root of 2."""
    helmert = np.array([[-1, 1, 0], [-1, -1, 2]]) / np.sqrt([[2], [6]])
    a, b = np.moveaxis(complex_preshapes(np.asarray(landmarks)) @ helmert.T, -1, 0)
    across = 2 * a.conj() * b
    points = [across.real, across.imag, abs(a) ** 2 - abs(b) ** 2]
    return np.stack(points, axis=-1) / np.sqrt(2)


@pytest.mark.parametrize("k", [3, 4, 22])
def test_distances_are_those_of_kendall(k):
    landmarks = configurations(9, k)
    shapes = mr.PlanarShapes(landmarks[0])
    assert shapes.point_shape == (2 * k - 3,) and shapes.dim == 2 * k - 4
    z = complex_preshapes(landmarks)
    expected = 2 * np.arccos(np.clip(abs(z[1:] @ z[:-1].conj().T), 0, 1)) ** 2
    p = shapes.from_landmarks(landmarks)
    found = shapes.squared_distance(p[1:, None], p[None, :-1])
    np.testing.assert_allclose(found, expected, atol=1e-7)  # arccos near 1
    log = shapes.log(p[0], p[1:])
    lengths = jnp.sum(shapes.orthonormal(p[0], log) ** 2, axis=-1)
    np.testing.assert_allclose(lengths, found[:, 0], rtol=1e-10)
    np.testing.assert_allclose(shapes.exp(p[0], log), p[1:], atol=1e-13)


def test_landmarks_are_superimposed_as_by_scipy():
    landmarks = configurations(6, 7)
    shapes = mr.PlanarShapes(landmarks[0])
    p = shapes.from_landmarks(landmarks)
    fitted = np.asarray(shapes.to_landmarks(p))
    for ours, given in zip(fitted, landmarks):
        first, other, _ = scipy.spatial.procrustes(landmarks[0], given)
        np.testing.assert_allclose(ours, other / np.linalg.norm(other), atol=1e-12)
        np.testing.assert_allclose(fitted[0], first, atol=1e-12)
    np.testing.assert_allclose(shapes.from_landmarks(fitted), p, atol=1e-14)
    own = np.asarray(shapes.to_landmarks(p, landmarks))
    z = complex_preshapes(landmarks)
    np.testing.assert_allclose(own[..., 0] + 1j * own[..., 1], z, atol=1e-13)


def test_the_reference_of_many_is_their_mean():
    """The shape of the least sum of squared sines, by its derivative."""
    landmarks = configurations(12, 5)
    shapes = mr.PlanarShapes(landmarks)
    p = shapes.from_landmarks(landmarks)
    centre = jnp.eye(1, 7)[0]
    np.testing.assert_allclose(
        shapes.from_landmarks(shapes.reference), centre, atol=1e-14
    )
    full_procrustes = lambda c: jnp.sum(
        jnp.sin(jnp.sqrt(shapes.squared_distance(shapes.project(c), p) / 2)) ** 2
    )
    np.testing.assert_allclose(jax.grad(full_procrustes)(centre), 0.0, atol=1e-12)
    first = complex_preshapes(landmarks[0])
    mean = np.asarray(shapes.reference) @ [1, 1j]
    assert abs(np.vdot(mean, first).imag) < 1e-14 and np.vdot(mean, first).real > 0


def test_shapes_forget_position_size_and_rotation_but_not_reflection():
    x = configurations(1, 6)[0]
    shapes = mr.PlanarShapes(configurations(1, 6, seed=1)[0])
    turn = Rotation.from_euler("z", 2.0).as_matrix()[:2, :2]
    p = shapes.from_landmarks(x)
    moved = shapes.from_landmarks(3.0 * x @ turn.T + [5.0, -1.0])
    np.testing.assert_allclose(p, moved, atol=1e-14)
    mirrored = shapes.from_landmarks(x * np.array([1.0, -1.0]))
    assert jnp.max(jnp.abs(p - mirrored)) > 0.1


def test_random_shapes_are_uniform(key):
    """Of triangles: the heights on their sphere are, about any axis."""
    shapes = mr.PlanarShapes(TRIANGLE)
    points = on_sphere(shapes.to_landmarks(shapes.random_points(key, 4000)))
    for axis in (points.T[0], points.T[2], on_sphere(TRIANGLE) @ points.T * 2**0.5):
        heights = np.sort(axis) / np.sqrt(0.5) / 2 + 0.5
        assert np.max(np.abs(heights - (np.arange(4000) + 0.5) / 4000)) < 0.03


@pytest.mark.parametrize("share", [0.5, 0.999, 1 - 1e-6, 1.0])
def test_logarithms_up_to_the_cut_locus(share, key):
    """From a point that is not the reference; 1: a right angle."""
    shapes = mr.PlanarShapes(configurations(1, 4)[0])
    p, q = shapes.random_points(key, 2)
    c = shapes.residual(p, q)
    c *= share * shapes.injectivity_radius / jnp.sqrt(jnp.sum(c**2))
    end = shapes.exp(p, shapes.from_orthonormal(p, c))
    v = shapes.log(p, end)
    length = jnp.sqrt(jnp.sum(shapes.orthonormal(p, v) ** 2))
    np.testing.assert_allclose(length, share * shapes.injectivity_radius, rtol=1e-9)
    np.testing.assert_allclose(shapes.exp(p, v), end, atol=1e-9)
    value, slope = jax.value_and_grad(shapes.squared_distance, argnums=1)(p, end)
    np.testing.assert_allclose(value, length**2, rtol=2e-2)
    assert jnp.all(jnp.isfinite(slope))


def test_small_circles_of_triangles_have_the_curvature_of_those_of_a_sphere():
    """Of radius 1/sqrt 2: at the polar angle a, sqrt 2 cot a. About a triangle that is
    not the reference."""
    shapes = mr.PlanarShapes(TRIANGLE)
    centre = shapes.from_landmarks(configurations(1, 3)[0])
    angle = 0.7
    axes = jnp.eye(3)[1:] * angle * np.sqrt(0.5)

    def circle(t):
        phase = t * np.sqrt(2) / np.sin(angle)
        c = jnp.cos(phase) * axes[0] + jnp.sin(phase) * axes[1]
        return shapes.exp(centre, shapes.from_orthonormal(centre, c))

    for order in (2, 3, 4):
        found = mr.energy(INTERVAL, shapes, circle, order=order)
        expected = (np.sqrt(2) / np.tan(angle)) ** (2 * order - 2)
        np.testing.assert_allclose(found, expected, rtol=1e-8)


@pytest.mark.slow
def test_paths_of_triangles_are_those_of_the_sphere():
    """And do not depend on the reference; nor do energies, and regions by little: the
    Gauss-Newton model drops what is linear in the residuals."""
    landmarks = configurations(25, 3)
    sphere = mr.Sphere(2, radius=np.sqrt(0.5))
    expected = mr.fit(INTERVAL, sphere, X, on_sphere(landmarks), 1e-3)
    queries = np.linspace(0, 1, 9)
    areas = np.prod(expected.posterior("known").region(queries).semi_axes, axis=1)
    for reference, tolerance in ((landmarks, 0.08), (landmarks[0], 0.15)):
        shapes = mr.PlanarShapes(reference)
        model = mr.fit(INTERVAL, shapes, X, shapes.from_landmarks(landmarks), 1e-3)
        path = on_sphere(shapes.to_landmarks(model(queries)))
        np.testing.assert_allclose(path, expected(queries), atol=1e-6)
        energies = model.energies
        np.testing.assert_allclose(energies.energy, expected.energies.energy, rtol=1e-5)
        np.testing.assert_allclose(energies.loss, expected.energies.loss, rtol=1e-6)
        axes = model.posterior("known").region(queries).semi_axes
        np.testing.assert_allclose(np.prod(axes, axis=1), areas, rtol=tolerance)


@pytest.mark.slow
def test_a_path_of_22_landmarks():
    """Far from its reference, too; a large lambda gives a geodesic."""
    landmarks = configurations(25, 22)
    paths, queries = [], np.linspace(0, 1, 9)
    for reference in (landmarks, landmarks[0]):
        shapes = mr.PlanarShapes(reference)
        y = shapes.from_landmarks(landmarks)
        model = mr.fit(INTERVAL, shapes, X, y, 1e-3)
        paths.append(shapes.to_landmarks(model(queries), landmarks[0]))
    np.testing.assert_allclose(*paths, atol=1e-6)
    model = mr.fit(INTERVAL, shapes, X, y, 1e4)
    size = lambda v: jnp.max(jnp.abs(shapes.orthonormal(model(X), v)))
    assert size(model.acceleration(X)) < 0.01 * size(model.velocity(X))


def test_triangles_as_a_source():
    """The area of a box of normal coordinates: sin(rho sqrt 2)/(rho sqrt 2) of it. On the
    sphere of radius r the Hessian of a height is - height/r^2 times the metric."""
    shapes = mr.PlanarShapes(TRIANGLE)
    origin = jnp.eye(1, 3)[0]
    u = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 2))
    u[:2] = [[-0.5, -0.5], [0.5, 0.5]]
    c = jnp.pad(jnp.array(u), ((0, 0), (1, 0)))
    p = shapes.exp(origin, shapes.from_orthonormal(origin, c))
    domain = discretise(shapes, 200, around=np.asarray(p))
    rho = lambda x, y: np.sqrt(2) * np.hypot(x, y)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    x, y = np.meshgrid(nodes / 2, nodes / 2)
    area = np.sum(np.outer(weights, weights) / 4 * np.sinc(rho(x, y) / np.pi))
    np.testing.assert_allclose(jnp.sum(domain.weights), area, rtol=1e-8)
    height = 2 * np.asarray(domain.points)[:, 0] ** 2 - 1  # over the radius
    found = mr.energy(shapes, mr.Euclidean(1), lambda p: 2 * p[:1] ** 2 - 1, domain)
    np.testing.assert_allclose(
        found, domain.weights @ (2 * (2 * height) ** 2), rtol=1e-8
    )
    far = shapes.random_points(jax.random.key(0), 50)
    with pytest.raises(ValueError, match="they end at 2.2. Take another reference"):
        discretise(shapes, 100, around=np.asarray(far))


@pytest.mark.parametrize("offset", [0.0, 1e7])
@pytest.mark.parametrize(
    "make",
    [
        lambda x: x.astype(int),
        lambda x: x.astype(np.uint16),
        lambda x: x.astype(np.float32),
        lambda x: x.astype(object),
        lambda x: [list(map(list, shape)) for shape in x],
        lambda x: np.ma.masked_array(x, mask=False),
        lambda x: jnp.asarray(x),
    ],
    ids=["int", "uint16", "float32", "object", "lists", "masked", "jax"],
)
def test_landmarks_in_numbers_of_any_kind(make, offset):
    """Pixels, and pixels of a large picture."""
    pixels = np.stack([TRIANGLE, TRIANGLE])
    pixels[1, 2] = [97, 3]
    shapes = mr.PlanarShapes(make(pixels))
    p = shapes.from_landmarks(make(pixels))
    assert p.dtype == jnp.float64
    angle = 2 * abs(np.vdot(*complex_preshapes(pixels)))  # to the mean of two: half
    np.testing.assert_allclose(2 * p[:, 0] ** 2 - 1, angle / 2, atol=1e-14)
    moved = shapes.from_landmarks(pixels + offset)
    np.testing.assert_allclose(moved, p, atol=1e-14)
    fitted = shapes.to_landmarks(p, make(pixels))
    np.testing.assert_allclose(shapes.from_landmarks(fitted), p, atol=1e-14)


def right_angled():
    """A triangle and one at right angles to it."""
    angles = 2 * np.pi / 3 * np.arange(3)
    corners = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return [corners, corners * [1.0, -1.0]]


SHAPES = mr.PlanarShapes(TRIANGLE)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: mr.PlanarShapes(4), r"landmarks \(k, 2\) to which .* found 4"),
        (lambda: mr.PlanarShapes(np.zeros((3, 3))), r"found shape \(3, 3\)"),
        (lambda: mr.PlanarShapes(np.eye(2)), "at least 3 landmarks, found 2"),
        (lambda: mr.PlanarShapes(np.ones((3, 2))), "`reference` .* coincide"),
        (lambda: SHAPES.from_landmarks(np.zeros((3, 3))), r"\(3, 3\)"),
        (lambda: SHAPES.from_landmarks(np.eye(4, 2)), r"\(\.\.\., 3, 2\), as the refe"),
        (lambda: SHAPES.from_landmarks(np.ones((3, 2))), "coincide"),
        (
            lambda: SHAPES.from_landmarks(
                np.stack([np.eye(3, 2), np.full((3, 2), 5e5 + 0.1)])
            ),
            "1 of 2 .*index 1",
        ),
        (
            lambda: SHAPES.from_landmarks(
                np.ma.masked_equal(np.arange(12.0).reshape(2, 3, 2), 8.0)
            ),
            "`landmarks`.* masked .*index 1",
        ),
        (
            lambda: mr.PlanarShapes(right_angled()[0]).from_landmarks(right_angled()),
            "1 of 2 shapes are at right angles to the reference .*index 1.*Take another",
        ),
        (
            lambda: mr.make_problem(
                INTERVAL, SHAPES, X[:3], -SHAPES.random_points(K, 3)
            ),
            "3 of 3 points lie on the other half sphere of PlanarShapes",
        ),
        (
            lambda: mr.make_problem(INTERVAL, SHAPES, X[:3], np.eye(3)),
            "y: 2 of 3 shapes are at right angles to the reference",
        ),
        (lambda: discretise(SHAPES, 50), "pass `around`"),
    ],
)
def test_refusals(make, message):
    with pytest.raises(ValueError, match=message):
        make()


K = jax.random.key(0)


def test_shapes_far_from_the_reference_raise_doubts():
    landmarks = np.stack(right_angled())
    shapes = mr.PlanarShapes(landmarks[0])
    p = shapes.from_landmarks(landmarks[1] + 0.05 * np.eye(3, 2))
    text = shapes.doubt(np.asarray(p)[None]) or ""
    assert text.startswith("1 of 1 shapes are nearly at right angles")
    assert SHAPES.doubt(np.asarray(SHAPES.from_landmarks(TRIANGLE))[None]) is None
