"""Surfaces known by points alone."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from clouds import sphere_points, torus_cloud

import manireg as mr


def test_normals_of_a_closed_surface():
    torus, truth = torus_cloud(1500)
    found = mr.load_surface(np.asarray(truth.points))
    cosine = np.sum(np.asarray(found.cloud.normals) * np.asarray(truth.normals), axis=1)
    assert cosine.min() > 0.99
    text = str(found.report)
    assert "estimated from 12 neighbours; 100 % of neighbours agree" in text
    assert "pointing outwards" in text
    at = 1.02 * np.asarray(truth.points)[::7]
    gap = np.asarray(
        found.cloud.project(jnp.asarray(at)) - torus.project(jnp.asarray(at))
    )
    assert np.abs(gap).max() < 5e-3


def test_an_open_surface_has_no_outside():
    x, y = np.random.default_rng(0).random((2, 400))
    found = mr.load_surface(np.stack([x, y, 0.1 * np.sin(3 * x)], axis=1))
    normals = np.asarray(found.cloud.normals)
    assert np.all(np.sign(normals[:, 2]) == np.sign(normals[0, 2]))
    assert "which side is out is a guess" in found.report.notable


def test_two_spheres_each_point_outwards():
    points = sphere_points(600)
    found = mr.load_surface(np.concatenate([points, points + 5.0]))
    both = np.asarray(found.cloud.normals)
    assert np.sum(both[: len(points)] * points, axis=1).min() > 0.9
    assert np.sum(both[len(points) :] * points, axis=1).min() > 0.9


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("offset", [0.0, 1e7])
def test_numbers_of_points(scale, offset):
    """Repeated ones, NaN, normals that are missing."""
    points = sphere_points(400)
    n = len(points)
    given = np.concatenate([[[np.nan] * 3], points, points[5:9]]) + offset
    normals = np.concatenate([points[:1], points, points[5:9]])
    normals[30:34] = 0
    found = mr.load_surface(scale * given, normals)
    np.testing.assert_array_equal(found.of_vertex[1:], [*range(n), *range(5, 9)])
    cosine = np.sum(np.asarray(found.cloud.normals) * points, axis=1)
    assert cosine.min() > 0.95 and len(found.cloud.points) == n
    assert np.all(np.isfinite(found.places))
    for line in (
        "1 points of NaN or infinity (first: 0)",
        "4 points at the place of another",
        "4 normals without a direction",
    ):
        assert line in str(found.report)


def ply(points, normals) -> str:
    names = "x y z nx ny nz".split()[: 3 if normals is None else 6]
    head = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    head += [f"property double {name}" for name in names] + ["end_header"]
    table = points if normals is None else np.c_[points, normals]
    return "\n".join([*head, *(" ".join(map(repr, r)) for r in table.tolist()), ""])


def obj(points, normals) -> str:
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    if normals is not None:
        rows += [f"vn {x!r} {y!r} {z!r}" for x, y, z in normals.tolist()]
    return "\n".join(rows)


def xyz(points, normals) -> str:
    table = points if normals is None else np.c_[points, normals]
    return "\n".join(
        [str(len(table)), *(" ".join(map(repr, r)) for r in table.tolist())]
    )


@pytest.mark.parametrize("write", [ply, obj, xyz])
@pytest.mark.parametrize("given", [True, False])
def test_files(tmp_path, write, given):
    """With normals inwards where there are any."""
    points = sphere_points(400)
    path = tmp_path / f"ball.{write.__name__}"
    path.write_text(write(points, -points if given else None))
    found = mr.load_surface(path)
    np.testing.assert_array_equal(found.vertices, points)
    inwards = np.sum(np.asarray(found.cloud.normals) * points, axis=1) < 0
    assert np.all(inwards == given)
    with pytest.raises(ValueError, match="no triangles, but .*`manireg.load_surface`"):
        mr.meshes.read_mesh(path)


def test_clouds_of_trimesh_and_ours():
    points = sphere_points(400)
    theirs = mr.load_surface(trimesh.PointCloud(points))
    cloud = mr.PointCloud(points, points)
    ours = mr.load_surface(cloud)
    np.testing.assert_allclose(theirs.cloud.normals, ours.cloud.normals, atol=0.1)
    np.testing.assert_array_equal(ours.cloud.bendings, cloud.bendings)


def test_lips_of_points_do_not_mix():
    """Two bent sheets back to back, a fifth of a spacing apart."""
    x, y = np.meshgrid(*[np.linspace(-1, 1, 21)] * 2)
    x, y = x.ravel(), y.ravel()
    sheet = np.stack([x, y, 0.5 * x**2], axis=1)
    normal = np.stack([-x, 0 * x, 1 + 0 * x], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    points = np.concatenate([sheet + 0.01 * normal, sheet - 0.01 * normal])
    cloud = mr.PointCloud(points, np.concatenate([normal, -normal]))
    bend = np.asarray(cloud.bendings)
    largest = np.abs(np.linalg.eigvalsh(bend)).max(axis=1)
    inner = np.tile((np.abs(x) < 0.7) & (np.abs(y) < 0.7), 2)
    exact = np.tile(1 / (1 + x**2) ** 1.5, 2)
    np.testing.assert_allclose(largest[inner], exact[inner], rtol=0.05)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((9, 3)), "points: all 9 are at one place"),
        (np.full((9, 3), np.nan), "points: none of 9 is finite"),
        (np.zeros((9, 2)), r"points: expected shape \(n, 3\)"),
        (np.eye(3), "points: 3 are too few"),
    ],
)
def test_bad_points(points, message):
    with pytest.raises(ValueError, match=message):
        mr.load_surface(points)
