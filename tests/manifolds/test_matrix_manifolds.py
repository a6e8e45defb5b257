"""Matrix manifolds against NumPy, SciPy and finite differences of values alone."""

# pyright: reportArgumentType=false, reportIndexIssue=false

import math
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.transform import Rotation

from manireg.manifolds import (
    Grassmann,
    Product,
    SpecialOrthogonal,
    Sphere,
    Stiefel,
    SymmetricPositiveDefinite,
)

MANIFOLDS = {
    "SO(2)": SpecialOrthogonal(2),
    "SO(3)": SpecialOrthogonal(3),
    "SO(4)": SpecialOrthogonal(4),
    "St(3,1)": Stiefel(3, 1),
    "St(4,2)": Stiefel(4, 2),
    "St(5,4)": Stiefel(5, 4),
    "Gr(3,1)": Grassmann(3, 1),
    "Gr(5,2)": Grassmann(5, 2),
    "SPD(3)": SymmetricPositiveDefinite(3),
}
FAST = ("SO(3)", "Gr(5,2)", "SPD(3)")  # the others: `pytest -m slow`


def over(manifolds):
    params = [
        pytest.param(m, id=name, marks=() if name in FAST else pytest.mark.slow)
        for name, m in manifolds.items()
    ]
    return pytest.mark.parametrize("manifold", params)


every = over(MANIFOLDS)
curved = over({name: m for name, m in MANIFOLDS.items() if name != "SPD(3)"})
at_point = pytest.mark.parametrize("offset", [0.0, 0.3], ids=["on", "off"])


@eqx.filter_jit
def call(manifold, method, *args):
    return getattr(manifold, method)(*args)


def derivative(f, order, h=0.03):
    """Derivative of f at 0 by the central formula on 11 values."""
    nodes = np.arange(-5, 6)
    rhs = np.zeros(11)
    rhs[order] = math.factorial(order)
    weights = np.linalg.solve(1.0 * nodes ** np.arange(11)[:, None], rhs) / h**order
    return np.tensordot(weights, np.asarray(jax.jit(jax.vmap(f))(h * nodes)), 1)


def ambient(manifold, key, *batch):
    v = jax.random.normal(key, (*batch, *manifold.point_shape))
    return v / jnp.sqrt(jnp.sum(v**2, axis=_axes(manifold), keepdims=True))


def tangent(manifold, key, p):
    v = call(manifold, "tangent_projection", p, jax.random.normal(key, p.shape))
    return v / jnp.sqrt(jnp.sum(v**2, axis=_axes(manifold), keepdims=True))


def _axes(manifold):
    return tuple(range(-len(manifold.point_shape), 0))


def logm(matrix):
    return np.real(np.asarray(scipy.linalg.logm(matrix)))


def skew(n, angles, seed=0):
    """A skew matrix with the given rotation angles."""
    w = np.zeros((n, n))
    for i, angle in enumerate(angles):
        w[2 * i, 2 * i + 1], w[2 * i + 1, 2 * i] = -angle, angle
    q = np.linalg.qr(np.random.default_rng(seed).normal(size=(n, n))).Q
    return q @ w @ q.T


PLANE = np.linalg.qr(np.random.default_rng(3).normal(size=(5, 5))).Q


def diagonal(*values):
    return np.diag(np.array(values, float))


# Projection


@pytest.mark.parametrize(
    "manifold",
    [SpecialOrthogonal(4), Stiefel(4, 2), Grassmann(4, 2)],
    ids=repr,
)
def test_decompositions_are_not_batched(manifold, key):
    """Two batches at a time may wait for each other for ever (jaxlib 0.10)."""
    points = ambient(manifold, key, 100)
    program = jax.jit(jax.vmap(manifold.project)).lower(points).compile().as_text()
    assert program is not None
    calls = re.findall(r"= (\(.*\)) custom-call\(.*lapack_\w+(?:ev|sd)d", program)
    assert calls
    assert not any(re.search(r"\[\d+,\d+,\d+\]", shapes) for shapes in calls)


@pytest.mark.parametrize("n", [2, 3, 4])
def test_closest_rotation_is_that_of_the_svd(n):
    p = np.random.default_rng(0).normal(size=(500, n, n))
    p[:100] *= 1e5
    u, s, vt = np.linalg.svd(p)
    sign = np.linalg.det(u @ vt)
    assert np.sum(sign < 0) > 100
    u[:, :, -1] *= sign[:, None]
    gap = (s[:, -2] + sign * s[:, -1]) / s[:, 0]
    error = np.abs(SpecialOrthogonal(n).project(jnp.asarray(p)) - u @ vt)
    assert np.max(error * gap[:, None, None]) < 2e-14


def test_closest_rotation_near_the_medial_axis():
    q = Rotation.random(2, np.random.default_rng(1)).as_matrix()
    for gap in (1e-2, 1e-4, 1e-6):
        p = q[0] @ np.diag([1.0, 0.5 + gap, -0.5]) @ q[1].T
        expected = q[0] @ q[1].T
        y = np.asarray(SpecialOrthogonal(3).project(jnp.asarray(p)))
        assert np.abs(y - expected).max() < 1e-14 / gap
        assert np.abs(y.T @ y - np.eye(3)).max() < 1e-12


@pytest.mark.parametrize("gap", [0.0, 1e-12, 1e-9, 1e-6])
@pytest.mark.parametrize("n", [2, 3, 4])
def test_closest_rotation_of_a_reflection(n, gap):
    """And next to one: many rotations are as close, and one of them is found."""
    turn = np.linalg.qr(np.random.default_rng(n).normal(size=(2, n, n))).Q
    turn[:, :, 0] *= np.linalg.det(turn)[:, None]
    values = np.ones(n)
    values[-1] = gap - 1.0
    p = turn[0] @ np.diag(values) @ turn[1].T
    y = np.asarray(SpecialOrthogonal(n).project(jnp.asarray(p)))
    np.testing.assert_allclose(y.T @ y, np.eye(n), atol=1e-14)
    assert np.linalg.det(y) == pytest.approx(1.0)
    assert np.linalg.norm(y - p) == pytest.approx(2.0 - gap, abs=1e-13)


@pytest.mark.parametrize(
    "manifold, p, distance",
    [
        (SpecialOrthogonal(2), np.zeros((2, 2)), 2**0.5),
        (SpecialOrthogonal(3), np.zeros((3, 3)), 3**0.5),
        (SpecialOrthogonal(3), -2e5 * np.eye(3), np.sqrt(2 * 199_999**2 + 200_001**2)),
        (SpecialOrthogonal(3), diagonal(1, 0, 0), 2**0.5),
        (SpecialOrthogonal(3), diagonal(3, 0.5, -0.5), np.sqrt(4 + 0.5 + 2.0)),
        (SpecialOrthogonal(4), diagonal(1, 1, 0, 0), 2**0.5),
        (Stiefel(4, 2), np.zeros((4, 2)), 2**0.5),
        (Stiefel(4, 2), np.eye(4, 2) * np.array([1.0, 0.0]), 1.0),
        (Grassmann(4, 2), np.eye(4), 2**0.5),
        (Grassmann(3, 1), diagonal(1, 1, 0), 1.0),
    ],
)
def test_projections_of_the_medial_axis(manifold, p, distance):
    """Nearest of several: on N, at the least distance, not a NaN."""
    y = call(manifold, "project", jnp.asarray(p))
    np.testing.assert_allclose(call(manifold, "project", y), y, atol=1e-13)
    assert np.linalg.norm(np.ravel(y - p)) == pytest.approx(distance, rel=1e-13)
    if isinstance(manifold, SpecialOrthogonal):
        assert np.linalg.det(np.asarray(y)) == pytest.approx(1.0)
    v = call(manifold, "tangent_projection", jnp.asarray(p), jnp.ones_like(y))
    assert jnp.all(jnp.isfinite(v))


def test_one_reflection_leaves_the_others_alone(key):
    """The batch with one has the values of the batch without."""
    p = jax.random.normal(key, (6, 3, 3))
    alone = call(SpecialOrthogonal(3), "project", p)
    among = call(SpecialOrthogonal(3), "project", p.at[2].set(-jnp.eye(3)))
    others = np.delete(np.arange(6), 2)
    np.testing.assert_array_equal(among[others], alone[others])


def test_closest_frame_is_the_polar_factor_of_scipy():
    p = np.random.default_rng(0).normal(size=(20, 5, 3))
    expected = [scipy.linalg.polar(x)[0] for x in p]
    y = Stiefel(5, 3).project(jnp.asarray(p))
    np.testing.assert_allclose(y, expected, atol=1e-13)


def test_closest_projector_is_that_of_eigh(key):
    p = np.asarray(jax.random.normal(key, (20, 5, 5)))
    vectors = np.linalg.eigh(p + np.swapaxes(p, 1, 2))[1][:, :, 3:]
    y = Grassmann(5, 2).project(jnp.asarray(p))
    np.testing.assert_allclose(y, vectors @ np.swapaxes(vectors, 1, 2), atol=1e-12)


@at_point
@every
def test_three_derivatives_of_the_projection(manifold, offset, key):
    keys = jax.random.split(key, 3)
    p = manifold.random_points(keys[0], 1)[0] + offset * ambient(manifold, keys[1])
    u = ambient(manifold, keys[2])

    def along(f):
        return lambda x: jax.jvp(f, (x,), (u,))[1]

    first = along(manifold.project)
    second, third = along(first), along(along(first))
    ours = jax.jit(lambda x: (first(x), second(x), third(x)))(p)
    for order, value in enumerate(ours, start=1):
        expected = derivative(lambda t: manifold.project(p + t * u), order)
        np.testing.assert_allclose(value, expected, atol=1e-6)


@curved
def test_reverse_mode_agrees_with_forward_mode(manifold, key):
    p = manifold.random_points(key, 1)[0]  # where eigenvalues coincide

    def value(x):
        return jnp.sum(jnp.sin(manifold.project(x)) * p)

    forward = jax.jit(jax.jacfwd(jax.jacfwd(value)))(p)
    reverse = jax.jit(jax.jacrev(jax.grad(value)))(p)
    np.testing.assert_allclose(reverse, forward, atol=1e-12)
    assert np.abs(forward).max() > 0.1


def _normal_that_ends_at_the_reach(manifold):
    """A point of N and a unit normal along which it stays closest up to the reach."""
    if isinstance(manifold, SpecialOrthogonal):
        normal = np.zeros((manifold.n, manifold.n))
        normal[-1, -1] = normal[-2, -2] = -np.sqrt(0.5)
        return np.eye(manifold.n), normal
    if isinstance(manifold, Stiefel):
        normal = np.zeros((manifold.n, manifold.p))
        normal[0, 0] = -1.0
        return np.eye(manifold.n, manifold.p), normal
    rank = manifold.p
    shape = manifold.point_shape[-2:]
    point, normal = np.zeros(shape), np.zeros(shape)
    point[:rank, :rank] = np.eye(rank)
    normal[rank - 1, rank - 1], normal[rank, rank] = -np.sqrt(0.5), np.sqrt(0.5)
    return point, normal


@curved
def test_reach(manifold):
    point, normal = map(jnp.asarray, _normal_that_ends_at_the_reach(manifold))
    inside = call(manifold, "project", point + 0.99 * manifold.reach * normal)
    outside = call(manifold, "project", point + 1.01 * manifold.reach * normal)
    np.testing.assert_allclose(inside, point, atol=1e-12)
    assert jnp.max(jnp.abs(outside - point)) > 0.5


@curved
def test_no_point_is_ambiguous_inside_the_reach(manifold, key):
    """p + normal of length < reach projects back to p."""
    keys = jax.random.split(key)
    p = manifold.random_points(keys[0], 200)
    v = ambient(manifold, keys[1], 200)
    v = v - call(manifold, "tangent_projection", p, v)
    v = v / jnp.sqrt(jnp.sum(v**2, axis=_axes(manifold), keepdims=True))
    y = call(manifold, "project", p + 0.95 * manifold.reach * v)
    np.testing.assert_allclose(y, p, atol=1e-10)


# Tangent spaces


@every
def test_tangent_projection_is_an_orthogonal_projector_of_rank_dim(manifold, key):
    keys = jax.random.split(key)
    p = manifold.random_points(keys[0], 1)[0]
    size = p.size
    matrix = jax.jit(jax.jacfwd(lambda v: manifold.tangent_projection(p, v)))(p)
    matrix = np.asarray(matrix).reshape(size, size)
    np.testing.assert_allclose(matrix @ matrix, matrix, atol=1e-12)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
    assert np.trace(matrix) == pytest.approx(manifold.dim)
    u = ambient(manifold, keys[1])
    differential = derivative(lambda t: manifold.project(p + t * u), 1)
    np.testing.assert_allclose(
        matrix @ u.ravel(), differential.ravel(), rtol=0, atol=1e-6
    )


@curved
def test_tangent_projection_off_the_manifold_is_that_of_the_closest_point(
    manifold, key
):
    keys = jax.random.split(key, 3)
    p = manifold.random_points(keys[0], 1)[0]
    p = p + 0.3 * ambient(manifold, keys[1])
    v = ambient(manifold, keys[2])
    np.testing.assert_allclose(
        call(manifold, "tangent_projection", p, v),
        call(manifold, "tangent_projection", call(manifold, "project", p), v),
        atol=1e-12,
    )


@every
def test_second_form_is_the_derivative_of_the_projector_field(manifold, key):
    keys = jax.random.split(key, 3)
    p = manifold.random_points(keys[0], 1)[0]
    u, v = tangent(manifold, keys[1], p), tangent(manifold, keys[2], p)
    expected = derivative(lambda t: manifold.tangent_projection(p + t * u, v), 1)
    ours = manifold.second_fundamental_form(p, u, v)
    np.testing.assert_allclose(ours, expected, atol=1e-7)


# Geodesics


@every
def test_geodesics_keep_their_speed_and_turn_only_with_the_manifold(manifold, key):
    keys = jax.random.split(key)
    p = manifold.random_points(keys[0], 1)[0]
    v = 1.5 * tangent(manifold, keys[1], p)

    def path(t):
        return manifold.exp(p, t * v)

    for t in (0.0, 1.0):
        velocity = derivative(lambda s: path(t + s), 1)
        acceleration = derivative(lambda s: path(t + s), 2)
        if t == 0.0:
            np.testing.assert_allclose(velocity, v, atol=1e-8)
        y = path(t)
        np.testing.assert_allclose(call(manifold, "project", y), y, atol=1e-12)
        assert np.sqrt(np.sum(velocity**2)) == pytest.approx(1.5, abs=1e-8)
        tangential = call(manifold, "tangent_projection", y, acceleration)
        np.testing.assert_allclose(tangential, 0.0, atol=1e-7)
        if not isinstance(manifold, SymmetricPositiveDefinite):
            assert np.abs(acceleration).max() > 0.1


@every
def test_log_inverts_exp_below_the_injectivity_radius(manifold, key):
    keys = jax.random.split(key)
    fraction = np.array([0.0, 1e-3, 0.5, 0.95]).reshape(-1, *[1] * len(_axes(manifold)))
    length = fraction * min(manifold.injectivity_radius, 10.0)
    p = manifold.random_points(keys[0], 4)
    v = length * tangent(manifold, keys[1], p)
    q = call(manifold, "exp", p, v)
    np.testing.assert_allclose(call(manifold, "log", p, q), v, atol=1e-10)
    expected = length.ravel() ** 2
    squared = call(manifold, "squared_distance", p, q)
    np.testing.assert_allclose(squared, expected, atol=1e-10)
    back = call(manifold, "squared_distance", q, p)
    np.testing.assert_allclose(back, expected, atol=1e-10)


def test_rotation_log_agrees_with_scipy_up_to_pi():
    manifold = SpecialOrthogonal(3)
    axis = np.random.default_rng(0).normal(size=(50, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    for angle in (1e-9, 1e-3, 1.0, 1.58, np.pi - 0.1, np.pi - 1e-3, np.pi - 1e-9):
        q = Rotation.from_rotvec(angle * axis).as_matrix()
        w = np.asarray(manifold.log(jnp.eye(3), jnp.asarray(q)))
        vector = np.stack([w[:, 2, 1], w[:, 0, 2], w[:, 1, 0]], axis=1)
        np.testing.assert_allclose(vector, angle * axis, rtol=1e-11, atol=1e-16)


@pytest.mark.parametrize(
    "angles", [(0.0, 0.0), (1.0, 1.0), (3.0, 0.0), (np.pi - 0.1, 2.9)]
)
@pytest.mark.parametrize("n", [4, 5])
def test_exp_and_log_of_larger_rotations_agree_with_scipy(n, angles):
    manifold = SpecialOrthogonal(n)
    w = skew(n, angles)
    q = manifold.exp(jnp.eye(n), jnp.asarray(w))
    np.testing.assert_allclose(q, scipy.linalg.expm(w), atol=1e-13)
    log = manifold.log(jnp.eye(n), jnp.asarray(scipy.linalg.expm(w)))
    np.testing.assert_allclose(log, w, atol=1e-12)
    far = manifold.exp(jnp.eye(n), jnp.asarray(10 * w))
    np.testing.assert_allclose(far, scipy.linalg.expm(10 * w), atol=1e-11)


def test_exp_says_so_when_a_rotation_is_too_long():
    w = jnp.asarray(skew(4, (1e3, 0.0)))
    assert jnp.all(jnp.isnan(SpecialOrthogonal(4).exp(jnp.eye(4), w)))


CUTS = {  # points p, q of the cut locus of each other, and their distance over pi sqrt(2)
    "SO(2)": (SpecialOrthogonal(2), np.eye(2), -np.eye(2), 1.0),
    "SO(3), x": (SpecialOrthogonal(3), np.eye(3), diagonal(1, -1, -1), 1.0),
    "SO(3), z": (SpecialOrthogonal(3), diagonal(-1, 1, -1), diagonal(1, 1, 1), 1.0),
    "SO(3)": (
        SpecialOrthogonal(3),
        Rotation.from_rotvec([0.3, 0.4, -2.0]).as_matrix(),
        Rotation.from_rotvec([0.3, 0.4, -2.0]).as_matrix()
        @ Rotation.from_rotvec(np.pi / 3 * np.array([1, -2, 2])).as_matrix(),
        1.0,
    ),
    "SO(4), one plane": (SpecialOrthogonal(4), np.eye(4), diagonal(1, -1, 1, -1), 1.0),
    "SO(4), all": (SpecialOrthogonal(4), np.eye(4), -np.eye(4), 2**0.5),
    "SO(5)": (
        SpecialOrthogonal(5),
        np.eye(5),
        PLANE @ diagonal(-1, 1, -1, -1, -1) @ PLANE.T,
        2**0.5,
    ),
    "Gr(3,1)": (Grassmann(3, 1), diagonal(1, 0, 0), diagonal(0, 0, 1), 0.5),
    "Gr(3,2)": (Grassmann(3, 2), diagonal(1, 1, 0), diagonal(0, 1, 1), 0.5),
    "Gr(4,2)": (Grassmann(4, 2), diagonal(1, 1, 0, 0), diagonal(0, 0, 1, 1), 0.5**0.5),
    "Gr(5,2)": (
        Grassmann(5, 2),
        PLANE[:, :2] @ PLANE[:, :2].T,
        PLANE[:, 1:3] @ PLANE[:, 1:3].T,
        0.5,
    ),
}


@pytest.mark.parametrize("name", CUTS)
def test_logarithms_at_the_cut_locus(name):
    """A geodesic of the right length whose end is q, also under jit and vmap."""
    manifold, p, q, length = CUTS[name]
    p, q = jnp.asarray(p), jnp.asarray(q)
    batched = jax.jit(jax.vmap(lambda p, q: manifold.log(p, q)))
    for v in (manifold.log(p, q), batched(p[None], q[None])[0]):
        assert float(jnp.sqrt(jnp.sum(v**2))) == pytest.approx(
            np.sqrt(2) * np.pi * length, rel=1e-12
        )
        np.testing.assert_allclose(call(manifold, "exp", p, v), q, atol=1e-13)
        tangent_part = call(manifold, "tangent_projection", p, v)
        np.testing.assert_allclose(tangent_part, v, atol=1e-13)


@pytest.mark.parametrize("share", [0.5, 0.9, 0.999, 1 - 1e-6, 1 - 1e-10])
@pytest.mark.parametrize("name", CUTS)
def test_logarithms_up_to_the_cut_locus(name, share):
    """Along the geodesic to a point of the cut locus."""
    manifold, p, q, _ = CUTS[name]
    v = share * call(manifold, "log", jnp.asarray(p), jnp.asarray(q))
    q = call(manifold, "exp", jnp.asarray(p), v)
    w = call(manifold, "log", jnp.asarray(p), q)
    np.testing.assert_allclose(call(manifold, "exp", jnp.asarray(p), w), q, atol=1e-9)
    length = float(jnp.sqrt(jnp.sum(v**2)))
    assert float(jnp.sqrt(jnp.sum(w**2))) == pytest.approx(length, abs=1e-8)


# Distances


def test_distances_agree_with_independent_formulas(key):
    keys = jax.random.split(key, 8)
    p, q = (np.asarray(SpecialOrthogonal(3).random_points(k, 1)[0]) for k in keys[:2])
    angle = Rotation.from_matrix(p.T @ q).magnitude()
    ours = SpecialOrthogonal(3).squared_distance(jnp.asarray(p), jnp.asarray(q))
    assert float(ours) == pytest.approx(2 * angle**2)
    p, q = (np.asarray(SpecialOrthogonal(5).random_points(k, 1)[0]) for k in keys[2:4])
    ours = SpecialOrthogonal(5).squared_distance(jnp.asarray(p), jnp.asarray(q))
    assert float(ours) == pytest.approx(np.sum(logm(p.T @ q) ** 2))
    for n, rank in ((5, 2), (5, 4), (3, 1)):
        frames = np.random.default_rng(n).normal(size=(2, n, rank))
        p, q = (x @ np.linalg.pinv(x) for x in frames)
        angles = scipy.linalg.subspace_angles(*frames)
        ours = Grassmann(n, rank).squared_distance(jnp.asarray(p), jnp.asarray(q))
        assert float(ours) == pytest.approx(2 * np.sum(angles**2))


def test_one_frame_vector_is_the_sphere(key):
    sphere, stiefel = Sphere(2), Stiefel(3, 1)
    p, q = sphere.random_points(key, 2)
    columns = p[:, None], q[:, None]
    np.testing.assert_allclose(
        stiefel.squared_distance(*columns), sphere.squared_distance(p, q), rtol=1e-11
    )
    np.testing.assert_allclose(
        stiefel.log(*columns)[:, 0], sphere.log(p, q), atol=1e-11
    )


@every
def test_two_derivatives_of_the_squared_distance(manifold, key):
    keys = jax.random.split(key, 3)
    p = manifold.random_points(keys[0], 1)[0]
    q = call(manifold, "exp", p, tangent(manifold, keys[1], p))
    u = ambient(manifold, keys[2])

    def loss(x):
        return manifold.squared_distance(p, manifold.project(x))

    def derivatives(x):
        return jax.jvp(jax.value_and_grad(loss), (x,), (u,))

    (_, gradient), (first, second) = jax.jit(derivatives)(q)
    line = lambda t: loss(q + t * u)
    np.testing.assert_allclose(first, derivative(line, 1), atol=1e-6)
    np.testing.assert_allclose(jnp.sum(gradient * u), first, atol=1e-10)
    np.testing.assert_allclose(jnp.sum(second * u), derivative(line, 2), atol=1e-5)


@every
def test_hessian_of_the_loss_at_coincidence_is_twice_the_metric(manifold, key):
    p = manifold.random_points(key, 2)

    def loss(x, y):
        return manifold.squared_distance(y, manifold.project(x))

    def hessian_and_metric(x):
        project = lambda v: manifold.tangent_projection(x, v)
        return jax.grad(loss)(x, x), jax.hessian(loss)(x, x), jax.jacfwd(project)(x)

    gradient, hessian, metric = jax.jit(jax.vmap(hessian_and_metric))(p)
    np.testing.assert_allclose(gradient, 0.0, atol=1e-12)
    np.testing.assert_allclose(hessian, 2 * metric, atol=1e-9)


@pytest.mark.parametrize("manifold", [SpecialOrthogonal(3), Grassmann(4, 1)], ids=str)
def test_distance_stays_finite_at_the_cut_locus(manifold, key):
    keys = jax.random.split(key)
    p = manifold.random_points(keys[0], 1)[0]
    q = manifold.exp(p, manifold.injectivity_radius * tangent(manifold, keys[1], p))
    distance = jax.value_and_grad(manifold.squared_distance, argnums=1)
    value, gradient = jax.jit(distance)(p, q)
    assert float(value) == pytest.approx(manifold.injectivity_radius**2, rel=2e-2)
    assert jnp.all(jnp.isfinite(gradient))


# Batches and random points


def _all_methods(manifold, p, u, v):
    q = manifold.exp(p, v)
    if isinstance(manifold, Stiefel):  # `shooting_log` has its own tests
        distance = log = jnp.zeros(())
    else:
        distance, log = manifold.squared_distance(p, q), manifold.log(p, q)
    projected = manifold.tangent_projection(p, u)
    second = manifold.second_fundamental_form(p, v, v)
    return manifold.project(p + u), projected, second, q, distance, log


@every
def test_batches_broadcast(manifold, key):
    keys = jax.random.split(key, 3)
    p = manifold.random_points(keys[0], 2)[:, None]
    u = ambient(manifold, keys[1], 2, 3)
    v = tangent(manifold, keys[2], jnp.repeat(p, 3, axis=1))
    batched = eqx.filter_jit(_all_methods)(manifold, p, u, v)
    single = eqx.filter_jit(_all_methods)(manifold, p[1, 0], u[1, 2], v[1, 2])
    for a, b in zip(batched, single, strict=True):
        if not isinstance(manifold, Stiefel):
            assert a.shape == (2, 3, *b.shape)
        a = a[1, 2] if a.ndim else a
        np.testing.assert_allclose(a, b, atol=1e-13)


@pytest.mark.parametrize(
    ("manifold", "mean"),
    [
        (SpecialOrthogonal(3), np.zeros((3, 3))),
        (SpecialOrthogonal(4), np.zeros((4, 4))),
        (Stiefel(4, 2), np.zeros((4, 2))),
        (Grassmann(5, 2), 0.4 * np.eye(5)),
    ],
    ids=str,
)
def test_random_points_are_uniform(manifold, mean, key):
    points = np.asarray(manifold.random_points(key, 4000))
    assert points.shape == (4000, *manifold.point_shape)
    np.testing.assert_allclose(manifold.project(jnp.asarray(points)), points, atol=1e-7)
    np.testing.assert_allclose(points.mean(axis=0), mean, atol=0.04)
    # Invariance: all entries of a row share their variance.
    if isinstance(manifold, SpecialOrthogonal | Stiefel):
        np.testing.assert_allclose(points.var(axis=0), 1 / manifold.n, atol=0.02)


def test_random_rotations_have_the_angles_of_the_haar_measure(key):
    r = SpecialOrthogonal(3).random_points(key, 4000)
    cosine = (np.trace(np.asarray(r), axis1=1, axis2=2) - 1) / 2
    angle = np.sort(np.arccos(np.clip(cosine, -1, 1)))
    uniform = (angle - np.sin(angle)) / np.pi  # its distribution function
    assert np.max(np.abs(uniform - (np.arange(4000) + 0.5) / 4000)) < 0.03


# Positive definite matrices


def test_matrices_in_numbers_of_any_kind():
    manifold = SymmetricPositiveDefinite(2)
    matrices = np.array([[[2, 1], [1, 2]], [[5, 0], [0, 1]]])
    expected = np.stack([logm(m) for m in matrices])
    for given in (matrices, matrices.tolist(), matrices.astype(np.float32)):
        p = manifold.from_matrices(given)
        assert p.dtype == jnp.float64
        np.testing.assert_allclose(p, expected, atol=1e-14)


def test_logarithms_and_matrices_agree_with_scipy(key):
    manifold = SymmetricPositiveDefinite(4)
    points = manifold.random_points(key, 5)
    matrices = np.stack([scipy.linalg.expm(np.asarray(p)) for p in points])
    np.testing.assert_allclose(manifold.to_matrices(points), matrices, rtol=1e-12)
    np.testing.assert_allclose(manifold.from_matrices(matrices), points, atol=1e-12)
    a, b = matrices[:2]
    difference = logm(a) - logm(b)
    p, q = manifold.from_matrices(matrices[:2])
    squared = float(manifold.squared_distance(p, q))
    assert squared == pytest.approx(np.sum(difference**2))


def test_matrices_in_place_of_logarithms_raise_doubts():
    spd = SymmetricPositiveDefinite(2)
    matrices = np.array([[[2e-3, 1e-4], [1e-4, 1e-3]], [[1e-3, 0.0], [0.0, 5e-4]]])
    logarithms = np.asarray(spd.from_matrices(matrices))
    assert "from_matrices" in (spd.doubt(matrices) or "")
    assert spd.doubt(logarithms) is None
    assert SymmetricPositiveDefinite(1).doubt(np.ones((3, 1, 1))) is None
    pair = Product(Sphere(2), spd)
    joined = lambda m: np.hstack([np.eye(3)[:2], m.reshape(2, 4)])
    assert (pair.doubt(joined(matrices)) or "").startswith("factor 1: all 2 points")
    assert pair.doubt(joined(logarithms)) is None
    assert Sphere(2).doubt(np.eye(3)) is None


@pytest.mark.parametrize("condition", [1e3, 1e6, 1e12])
def test_logarithm_of_ill_conditioned_matrices(condition):
    q = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3))).Q
    values = np.array([1.0, np.sqrt(condition), condition])
    matrix = (q * values) @ q.T
    ours = SymmetricPositiveDefinite(3).from_matrices((matrix + matrix.T) / 2)
    expected = (q * np.log(values)) @ q.T
    np.testing.assert_allclose(ours, expected, atol=1e-12 + 1e-17 * condition)


@pytest.mark.parametrize("values", [(1.0, 1.0, 1.0), (3.0, 3.0, 0.5)])
def test_derivatives_of_the_logarithm_at_repeated_eigenvalues(values, key):
    manifold = SymmetricPositiveDefinite(3)
    matrix = jnp.diag(jnp.array(values))
    u = 0.3 * manifold.project(jax.random.normal(key, (3, 3)))

    def along(f):
        return lambda x: jax.jvp(f, (x,), (u,))[1]

    first = along(manifold.from_matrices)
    for order, f in ((1, first), (2, along(first))):
        expected = derivative(
            lambda t: jnp.asarray(manifold.from_matrices(matrix + t * u)), order
        )
        np.testing.assert_allclose(jax.jit(f)(matrix), expected, atol=1e-7)


# Refusals


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SpecialOrthogonal(1), "`n` must be at least 2, found 1"),
        (lambda: Stiefel(3, 3), r"use SpecialOrthogonal\(3\)"),
        (lambda: Stiefel(3, 4), "found p = 4, n = 3"),
        (lambda: Stiefel(3, 0), "found p = 0, n = 3"),
        (lambda: Grassmann(3, 3), "found p = 3, n = 3"),
        (lambda: SymmetricPositiveDefinite(0), "`n` must be at least 1, found 0"),
        (
            lambda: SymmetricPositiveDefinite(2).from_matrices(
                np.ma.masked_equal(np.stack([np.eye(2), 9 * np.eye(2)]), 9.0)
            ),
            "`matrices`.* masked .*index 1",
        ),
        (
            lambda: SymmetricPositiveDefinite(2).from_matrices(
                np.stack([np.eye(2), np.zeros((2, 2))])
            ),
            "1 of 2 .*index 1",
        ),
        (
            lambda: SymmetricPositiveDefinite(2).from_matrices(np.diag([1.0, -0.5])),
            "eigenvalue -0.5",
        ),
        (
            lambda: SymmetricPositiveDefinite(2).from_matrices(
                np.array([[2.0, 1], [0, 2]])
            ),
            "symmetric",
        ),
        (
            lambda: SymmetricPositiveDefinite(2).from_matrices(np.full((2, 2), np.nan)),
            "symmetric",
        ),
        (lambda: SymmetricPositiveDefinite(2).from_matrices(np.eye(3)), r"\(3, 3\)"),
    ],
)
def test_bad_arguments_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()
