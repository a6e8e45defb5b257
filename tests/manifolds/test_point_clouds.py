"""Surfaces known by points and normals, against the surfaces they were taken from."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from clouds import sphere_cloud, sphere_points, torus_cloud

import manireg as mr
from manireg._discretisation.jets import jet_values
from manireg._objective.patches import moved, patches_near
from manireg._solver.linear import direct_solvers
from manireg._solver.starts import free_solution
from manireg.manifolds._scans.quadric_patch import QuadricPatch

PATCH = QuadricPatch(
    origin=jnp.array([1.0, 0.0, -1.0]),
    frame=jnp.array([[0.0, 0.6], [1.0, 0.0], [0.0, 0.8]]),
    normal=jnp.array([0.8, 0.0, -0.6]),
    slope=jnp.array([0.2, -0.1]),
    bending=jnp.array([[0.5, 0.3], [0.3, -0.8]]),
)


def on_the_graph(p):
    """Zero on the surface of `PATCH`."""
    u = PATCH.frame.T @ (p - PATCH.origin)
    height = PATCH.slope @ u + 0.5 * u @ PATCH.bending @ u
    return PATCH.normal @ (p - PATCH.origin) - height


@pytest.mark.slow
def test_patch_is_the_level_set_of_its_graph():
    """Closest points and their derivatives up to the third, from another solver."""
    level_set = mr.LevelSet(on_the_graph, 3, reach=1.0, center=PATCH.origin)
    p = PATCH.origin + 0.2 * jax.random.normal(jax.random.key(0), (5, 3))
    u, v, z = jax.random.normal(jax.random.key(1), (3, 5, 3))

    def derivatives(manifold):
        def along(f, v):
            return lambda p: jax.jvp(f, (p,), (v,))[1]

        first = along(manifold.project, u)
        second = along(first, v)
        return manifold.project(p), first(p), second(p), along(second, z)(p)

    for ours, theirs in zip(derivatives(PATCH), derivatives(level_set), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-8)
    y = PATCH.project(p)
    ours, theirs = [
        m.second_fundamental_form(
            y, m.tangent_projection(y, u), m.tangent_projection(y, v)
        )
        for m in (PATCH, level_set)
    ]
    np.testing.assert_allclose(ours, theirs, atol=1e-10)


def test_cloud_of_a_torus_is_a_torus():
    torus, cloud = torus_cloud(4000)
    y = torus.random_points(jax.random.key(0), 200)
    p = y + 0.1 * jax.random.normal(jax.random.key(1), y.shape)
    np.testing.assert_allclose(cloud.project(p), torus.project(p), atol=1e-3)
    u = torus.tangent_projection(y, jnp.ones_like(y))
    np.testing.assert_allclose(cloud.tangent_projection(y, u), u, atol=1e-2)
    form, exact = (m.second_fundamental_form(y, u, u) for m in (cloud, torus))
    assert jnp.linalg.norm(form - exact) < 4e-2 * jnp.linalg.norm(exact)
    assert float(jnp.sum(cloud.areas)) == pytest.approx(4 * np.pi**2 * 1.6, rel=1e-2)
    out = cloud.signed_distance(y * 1.0 + 0.1 * normal_of(torus, y))
    np.testing.assert_allclose(out, 0.1, atol=2e-4)


def normal_of(torus, y):
    rho = jnp.linalg.norm(y[:, :2], axis=1, keepdims=True)
    n = y - torus.R * jnp.pad(y[:, :2] / rho, ((0, 0), (0, 1)))
    return n / jnp.linalg.norm(n, axis=1, keepdims=True)


def test_curve_in_the_plane():
    angle = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    circle = 2 * np.stack([np.cos(angle), np.sin(angle)], 1)
    cloud = mr.PointCloud(circle, circle)
    assert float(jnp.sum(cloud.areas)) == pytest.approx(4 * np.pi, rel=1e-2)
    p = jnp.array([[1.0, 1.0], [-3.0, 0.5]])
    exact = 2 * p / jnp.linalg.norm(p, axis=1, keepdims=True)
    np.testing.assert_allclose(cloud.project(p), exact, atol=1e-5)


@pytest.mark.slow
def test_energies_on_a_cloud():
    """Moebius dilation of the sphere: (8 pi/3)(k - 1/k)^2; the inclusion: 8 pi."""
    cloud, k = sphere_cloud(5000), 1.5

    def dilation(p):
        plane = k * p[:2] / (1 - p[2])
        size = jnp.sum(plane**2)
        return jnp.append(2 * plane, size - 1) / (size + 1)

    exact = 8 * np.pi / 3 * (k - 1 / k) ** 2
    energy = mr.eells_energy(cloud, mr.Sphere(2), dilation, samples=5000)
    assert float(energy) == pytest.approx(exact, rel=1e-2)
    both = mr.eells_energy(cloud, cloud, dilation, samples=5000)
    assert float(both) == pytest.approx(exact, rel=1e-2)
    inclusion = mr.eells_energy(cloud, mr.Euclidean(3), lambda p: p, samples=5000)
    assert float(inclusion) == pytest.approx(8 * np.pi, rel=1e-2)
    ambient = mr.eells_energy(mr.Ambient(cloud), mr.Euclidean(3), lambda p: p)
    assert abs(float(ambient)) < 1e-12


@pytest.mark.slow
def test_rotation_from_cloud_to_cloud():
    cloud = sphere_cloud(2000)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    x = np.asarray(cloud.points)[::80]
    y = cloud.project(jnp.asarray(x @ turn.T))
    for source in (cloud, mr.Ambient(cloud)):
        model = mr.fit(source, cloud, x, y, 1e-2, centres=60, degree=1)
        new = np.asarray(cloud.points)[7::100]
        gap = np.linalg.norm(model(new) - new @ turn.T, axis=1)
        assert gap.max() < 5e-3
        assert model.energies.eells < 1e-2


def test_rotation_of_a_circle_of_points():
    """From cloud to cloud, as above in one dimension less."""
    angle = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    points = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    cloud = mr.PointCloud(points, points)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    x = points[::5]
    y = cloud.project(jnp.asarray(x @ turn.T))
    model = mr.fit(cloud, cloud, x, y, 1e-2, centres=25, degree=1)
    gap = np.linalg.norm(model(points[2::7]) - points[2::7] @ turn.T, axis=1)
    assert gap.max() < 5e-3
    assert model.energies.eells < 1e-2


def flipped(points):
    return np.where(points[:, 2:] > 0.5, -points, points)


@pytest.mark.parametrize(
    ("points", "normals", "message"),
    [
        (np.zeros((30, 4)), np.ones((30, 4)), r"points: expected shape \(P, 3\)"),
        (sphere_points(320), np.ones((3, 3)), r"normals: expected shape \(320, 3\)"),
        (
            np.where(np.arange(320)[:, None] == 7, np.nan, sphere_points(320)),
            sphere_points(320),
            "points: 1 of 320 hold NaN or infinity .first at index 7",
        ),
        (
            np.repeat(sphere_points(160), 2, axis=0),
            np.repeat(sphere_points(160), 2, axis=0),
            "points: 160 of 320 are repetitions",
        ),
        (sphere_points(320), np.zeros((320, 3)), "normals: 320 have no length"),
        (
            sphere_points(1600),
            flipped(sphere_points(1600)),
            "neighbours' normals point to the other side",
        ),
    ],
    ids=["dimension", "length", "NaN", "repeated", "zero normal", "flipped patch"],
)
def test_bad_points(points, normals, message):
    with pytest.raises(ValueError, match=message):
        mr.PointCloud(points, normals)


def test_neighbours():
    with pytest.raises(ValueError, match="neighbours: must be at least 6 .* found 3"):
        sphere_cloud(320, neighbours=3)


@pytest.mark.parametrize("areas", [np.ones(3), np.zeros(320)])
def test_areas(areas):
    with pytest.raises(ValueError, match="areas: expected 320 positive numbers"):
        sphere_cloud(320, areas=areas)


@pytest.mark.parametrize("kind", ["ply", "obj", "stl"])
def test_mesh_files(tmp_path, kind):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=2.0)
    ball.export(tmp_path / f"ball.{kind}")
    cloud = mr.PointCloud.from_mesh(tmp_path / f"ball.{kind}")
    assert len(cloud.points) == len(ball.vertices)
    assert float(jnp.sum(cloud.areas)) == pytest.approx(ball.area, rel=1e-6)
    assert cloud.signed_distance(jnp.array([2.5, 0.0, 0.0])) == pytest.approx(0.5, 1e-3)


def test_bad_meshes(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2)
    two = trimesh.util.concatenate([ball, ball.copy().apply_translation([5, 0, 0])])
    both = mr.PointCloud.from_mesh(two)
    with pytest.raises(ValueError, match="source: 2 components that do not touch"):
        mr.make_problem(both, mr.Euclidean(1), both.points[::9], both.points[::9, :1])
    faces = np.where(
        np.arange(len(ball.faces))[:, None] < 40, ball.faces[:, ::-1], ball.faces
    )
    turned = trimesh.Trimesh(ball.vertices, faces, process=False)
    with pytest.warns(UserWarning, match="40 triangles wound against their neigh"):
        cloud = mr.PointCloud.from_mesh(turned)
    assert float(jnp.min(jnp.sum(cloud.normals * cloud.points, axis=1))) > 0
    with pytest.raises(ValueError, match="trimesh cannot load"):
        mr.PointCloud.from_mesh(tmp_path / "missing.ply")
    line = trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], process=False
    )
    with pytest.raises(ValueError, match="all 1 triangles are degenerate"):
        mr.PointCloud.from_mesh(line)


def test_padding_changes_nothing():
    cloud = sphere_cloud(500)
    padded = cloud.padded(1200)
    p = jnp.array([[0.3, 0.4, 1.2], [-2.0, 0.1, 0.0]])
    assert padded.points.shape == (1200, 3)
    assert np.array_equal(padded.project(p), cloud.project(p))
    assert np.isclose(jnp.sum(padded.areas), jnp.sum(cloud.areas))
    assert np.isclose(padded.reach, cloud.reach)
    with pytest.raises(ValueError, match="size"):
        cloud.padded(400)


@pytest.mark.slow
def test_patches_near_a_map():
    """Held while they are about nearest, and flat enough for the closest point to be
    smooth where the map is."""
    cloud = sphere_cloud(500)
    x = sphere_points(160)[:40]
    problem = mr.make_problem(mr.Sphere(2), cloud, x, x, centres=40)
    problem = eqx.tree_at(lambda p: p.origin, problem, jnp.zeros(3))
    w = 0.4 * free_solution(problem, 1e-3, direct_solvers(problem))
    local = patches_near(problem, w)
    assert local is not None
    psi = jet_values(problem.energy_jets, w)[:, :, 0]
    gap = np.linalg.norm(psi - local.near[0].origin, axis=-1)
    bend = np.linalg.norm(local.near[0].bending, axis=(-2, -1))
    assert gap.max() > 0.55 and np.max(gap * bend) < 0.5 + 1e-9
    quarter = jnp.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    same, turned = (patches_near(problem, v, local) for v in (1.001 * w, w @ quarter))
    assert same is not None and turned is not None
    assert float(moved(local, same)) == 0.0 and float(moved(local, turned)) > 0.5
