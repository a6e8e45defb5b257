"""Derivatives of a fitted map: against finite differences of its values, and where they
are known."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from clouds import sphere_cloud
from scipy.spatial.transform import Rotation

import manireg as mr
from manireg._discretisation.local_polynomials import basis_values

K = 300
T = np.linspace(0, 1, K)
INSIDE = np.array([0.11, 0.37, 0.5, 0.83])
RNG = np.random.default_rng(0)


def model_of(source, target, x, y, centres=12, **options):
    """The map of the class that is next to y, by least squares: all of a model, and no
    solver to be compiled. Psi is off the target."""
    problem = mr.make_problem(source, target, x, y, centres=centres, **options)
    basis, at, y = problem.basis, problem.x, np.asarray(problem.y)
    every = jnp.arange(len(basis.centres))
    rows = jax.jit(jax.vmap(lambda p: basis_values(basis, p, every)))(at)
    y = y * (1 + 0.2 * np.sin(at[:, :1]))
    w = np.linalg.lstsq(np.asarray(rows), y - problem.origin)[0]
    none = jnp.zeros(())
    energies = mr.Energies(none, none, none, {})
    return mr.RegressionMap(
        source, target, basis, problem.origin, jnp.asarray(w), none, energies,
        optx.RESULTS.successful, {},
    )  # fmt: skip


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def wave(t):
    return np.stack([1 + 0 * t, np.sin(3 * t), np.cos(2 * t) - 0.5], axis=-1)


def difference(f, h=1e-3):
    """A derivative at 0, of fourth order."""
    f = (np.asarray(f(h)) - f(-h), np.asarray(f(2 * h)) - f(-2 * h))
    return (8 * f[0] - f[1]) / (12 * h)


def assert_close(found, truth, rtol=1e-6):
    np.testing.assert_allclose(found, truth, atol=rtol * np.max(np.abs(truth)))


def check_curve(model, x, moved=lambda x, h: x + h, h=1e-3):
    """`moved(x, h)`: farther by h. The acceleration is the tangent part of the second
    ambient derivative."""
    along = lambda f: difference(lambda h: f(moved(x, h)), h)
    velocity, change = along(model), along(model.velocity)
    assert_close(model.velocity(x), velocity)
    tangent = model.target.tangent_projection(model(x), jnp.asarray(change))
    assert_close(model.acceleration(x), tangent)


@pytest.fixture(scope="module")
def on_sphere():
    return model_of(mr.Interval(0, 1), mr.Sphere(2), T, unit(wave(T)))


@pytest.fixture(scope="module")
def between_spheres():
    x = unit(RNG.normal(size=(K, 3)))
    y = unit(x + 0.3 * np.roll(x, 1, axis=1) ** 2)
    return model_of(mr.Sphere(2), mr.Sphere(2), x, y, centres=40)


@pytest.fixture(scope="module")
def of_rotations():
    x = Rotation.random(K, np.random.default_rng(0)).as_matrix()
    y = unit(x[:, 0] + [0.5, 0, 0])
    return model_of(mr.SpecialOrthogonal(3), mr.Euclidean(3), x, y, width=1.2)


def test_on_the_sphere(on_sphere):
    check_curve(on_sphere, INSIDE)


def test_of_rotations():
    turns = Rotation.from_rotvec(wave(T)).as_matrix()
    check_curve(model_of(mr.Interval(0, 1), mr.SpecialOrthogonal(3), T, turns), INSIDE)


@pytest.mark.parametrize("period", [1.0, 24.0])
def test_along_a_circle_x_has_the_unit_of_the_period(period):
    angle = 2 * np.pi * T[:-1]
    y = np.stack([np.cos(angle), 0.5 * np.sin(2 * angle)], axis=1)
    model = model_of(mr.Circle(period), mr.Euclidean(2), period * T[:-1], y)
    x = period * np.array([-0.2, 0.1, 0.4, 1.3])
    check_curve(model, x, h=3e-4 * period)
    assert_close(model.velocity(x + period), model.velocity(x), 1e-12)
    assert model.differential(x).derivatives.shape == (4, 2, 1)


def test_a_circle_of_points_is_run_through_counterclockwise():
    circle = lambda a: 2 * np.stack([np.cos(a), np.sin(a)], axis=-1)
    angle = 2 * np.pi * T[:-1]
    model = model_of(
        mr.Sphere(1, 2.0), mr.Sphere(1), circle(angle), circle(2 * angle) / 2
    )
    x = circle(6 * INSIDE)
    on = lambda x, h: circle(np.arctan2(x[:, 1], x[:, 0]) + h / 2)
    check_curve(model, x, on)


def test_a_great_circle_has_no_acceleration():
    """On a sphere of radius 2, at 0.8 radians per unit of x."""
    first, second = np.linalg.qr(RNG.normal(size=(3, 2)))[0].T
    circle = lambda t: 2 * (np.outer(np.cos(t), first) + np.outer(np.sin(t), second))
    x, new = np.linspace(0, 3, 30), 3 * INSIDE
    data = mr.Interval(0, 3), mr.Sphere(2, 2.0), x, circle(0.8 * x)
    model = mr.fit(*data, 1e-4, centres=12, starts=(1.0,))
    v = model.velocity(new)
    np.testing.assert_allclose(np.linalg.norm(v, axis=1), 2 * 0.8, rtol=1e-4)
    np.testing.assert_allclose(model.acceleration(new), 0, atol=1e-3)
    motion = mr.sphere_motion(model(new), v)
    np.testing.assert_allclose(motion.speed, 0.8, rtol=1e-4)
    pole = np.broadcast_to(np.cross(first, second), (4, 3))
    np.testing.assert_allclose(motion.euler_pole, pole, atol=1e-4)


def test_of_a_scan():
    model = model_of(mr.Interval(0, 1), sphere_cloud(400), T, unit(wave(T)))
    check_curve(model, np.array([0.2, 0.6]), h=1e-5)  # its patches meet at jumps


def check_differential(model, x, moved):
    """`moved(x, e, h)`: from x in the direction e, by h."""
    found = model.differential(x)
    n, s, m = found.frame.shape
    assert found.derivatives.shape == (n, *model.target.point_shape, m)
    gram = np.einsum("nsa,nsb->nab", found.frame, found.frame)
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(m), gram.shape), atol=1e-12)
    for a in range(m):
        e = np.asarray(found.frame[..., a]).reshape(x.shape)
        truth = difference(lambda h: model(moved(x, e, h)))
        assert_close(found.derivatives[..., a], truth)


def test_differential_of_a_map_of_spheres(between_spheres):
    along = lambda x, e, h: np.cos(h) * x + np.sin(h) * e
    check_differential(between_spheres, unit(RNG.normal(size=(5, 3))), along)
    single = between_spheres.differential(np.array([0.0, 0.0, 1.0]))
    assert single.derivatives.shape == single.frame.shape == (3, 2)


def test_differential_on_rotations(of_rotations):
    group = mr.SpecialOrthogonal(3)
    along = lambda x, e, h: group.exp(jnp.asarray(x), jnp.asarray(h * e))
    new = Rotation.random(3, np.random.default_rng(1)).as_matrix()
    check_differential(of_rotations, new, along)


def test_frames_of_vector_spaces_are_the_axes():
    x = RNG.uniform(size=(K, 2))
    model = model_of(mr.Box([0, 0], [1, 1]), mr.Sphere(2), x, unit(wave(x @ [1, 0.5])))
    new = x[:5] * 0.8 + 0.1
    check_differential(model, new, lambda x, e, h: x + h * e)
    np.testing.assert_array_equal(model.differential(new[0]).frame, np.eye(2))

    x = unit(RNG.normal(size=(K, 3)))
    model = model_of(mr.Ambient(mr.Sphere(2)), mr.Euclidean(2), x, x[:, :2], centres=40)
    found = model.differential(x[:4])
    assert found.derivatives.shape == (4, 2, 3)
    np.testing.assert_array_equal(found.frame[0], np.eye(3))


class Cone(mr.AbstractSource):
    """Nothing says which coordinates its points have."""

    dim = 2
    point_shape = (3,)

    def chart(self, around):
        embed = lambda u: u[1] * jnp.stack([jnp.cos(u[0]), jnp.sin(u[0]), 1.0])
        return mr.Chart([0, 1], [2 * jnp.pi, 2], [True, False], embed)


class Helix(mr.AbstractSource):
    """A curve by its points, of speed sqrt 2 in its coordinate."""

    dim = 1
    point_shape = (3,)

    def chart(self, around):
        embed = lambda u: jnp.stack([jnp.cos(u[0]), jnp.sin(u[0]), u[0]])
        return mr.Chart([0], [7], [False], embed)


class Coil(Helix):
    """The same, x the coordinate."""

    point_shape = ()

    def to_ambient(self, x):
        return jnp.stack([jnp.cos(x), jnp.sin(x), x], axis=1)

    def from_ambient(self, p):
        return p[:, 2]


def helix(t):
    return np.stack([np.cos(t), np.sin(t), t], axis=-1)


def test_on_a_source_with_nothing_but_a_chart():
    angle, z = RNG.uniform(0, 6, K), RNG.uniform(1, 2, K)
    across = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    x = np.stack([z * np.cos(angle), z * np.sin(angle), z], axis=1)
    model = model_of(Cone(), mr.Euclidean(2), x, x[:, :2] ** 2)
    frame = np.stack([across, unit(x)], axis=2)
    np.testing.assert_allclose(model.differential(x).frame, frame, atol=1e-9)


def test_along_a_curve_with_nothing_but_a_chart():
    y = np.stack([np.cos(3 * T), np.sin(3 * T)], axis=1)
    model = model_of(Helix(), mr.Sphere(1), helix(7 * T), y)
    check_curve(model, helix(7 * INSIDE), lambda x, h: helix(x[:, 2] + h / np.sqrt(2)))
    own = model_of(Coil(), mr.Sphere(1), 7 * T, y)
    check_curve(own, 7 * INSIDE)
    by_length = np.sqrt(2) * model.velocity(helix(7 * INSIDE))
    assert_close(own.velocity(7 * INSIDE), by_length)
    found = own.differential(7 * INSIDE).derivatives[..., 0]
    assert_close(found, model.velocity(helix(7 * INSIDE)))


def test_single_points_and_errors(on_sphere, between_spheres):
    many, one = on_sphere.velocity(INSIDE), on_sphere.velocity(INSIDE[1])
    np.testing.assert_array_equal(one, many[1])
    assert on_sphere.acceleration(0.5).shape == (3,)
    with pytest.raises(ValueError, match="x: 1 of 1 points lie outside the interval"):
        on_sphere.velocity(1.5)
    with pytest.raises(ValueError, match="NaN"):
        on_sphere.acceleration(np.nan)
    narrow = eqx.tree_at(
        lambda m: m.basis.widths, on_sphere, on_sphere.basis.widths / 9
    )
    with pytest.raises(ValueError, match="outside the support of every centre"):
        narrow.velocity(INSIDE)
    for name in ("velocity", "acceleration"):
        with pytest.raises(
            ValueError, match=f"{name}.*dimension 2; take `differential`"
        ):
            getattr(between_spheres, name)(np.eye(3))


def test_transforms(on_sphere, between_spheres):
    for f in (on_sphere.velocity, on_sphere.acceleration):
        np.testing.assert_allclose(jax.jit(f)(INSIDE), f(INSIDE), atol=1e-12)
        np.testing.assert_allclose(jax.vmap(f)(INSIDE), f(INSIDE), atol=1e-12)
    slope = jax.vmap(jax.jacfwd(on_sphere))(jnp.asarray(INSIDE))
    np.testing.assert_allclose(slope, on_sphere.velocity(INSIDE), atol=1e-12)
    f = between_spheres.differential
    for found, truth in zip(jax.jit(f)(np.eye(3)), f(np.eye(3)), strict=True):
        np.testing.assert_allclose(found, truth, atol=1e-12)
    with pytest.raises(RuntimeError, match="outside the interval"):
        jax.block_until_ready(jax.jit(on_sphere.velocity)(1.5))
