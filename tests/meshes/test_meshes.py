"""Whose vertex is number i, which triangles meet, which side is out: meshes as people have
them, at any size and distance from the origin."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from ball_meshes import (
    BALL,
    F,
    V,
    doubled,
    lines,
    materials_obj,
    textured_obj,
    unused_obj,
)
from scipy.spatial import KDTree

import manireg as mr
from manireg._discretisation.domain import centres_of, discretise
from manireg.meshes import largest_component, read_mesh, wound_alike, write_mesh
from manireg.meshes._clean import mesh_surface


@pytest.mark.parametrize("make", [textured_obj, unused_obj, materials_obj])
def test_obj_files_keep_their_vertices(tmp_path, make):
    text, vertices = make()
    (tmp_path / "ball.obj").write_text("\n".join(text))
    mesh = read_mesh(tmp_path / "ball.obj")
    np.testing.assert_array_equal(mesh.vertices, vertices)
    cloud = mr.PointCloud.from_mesh(tmp_path / "ball.obj")
    assert cloud.of_vertex is not None
    assert len(cloud.points) == len(V) and len(cloud.of_vertex) == len(vertices)
    used = np.unique(mesh.faces)
    np.testing.assert_array_equal(cloud.points[cloud.of_vertex][used], vertices[used])
    assert cloud.areas.sum() == pytest.approx(BALL.area)


def test_polygons(tmp_path):
    """Quads are cut, vertices stay."""
    n, k = 7, np.arange(49).reshape(7, 7)
    x, y = np.meshgrid(*[np.linspace(0, 1, n)] * 2, indexing="ij")
    vertices = np.stack([x, y, x * y], axis=-1).reshape(-1, 3)
    quads = np.stack([k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]], -1).reshape(
        -1, 4
    )
    text = lines("v", vertices) + lines("f", quads + 1)
    (tmp_path / "sheet.obj").write_text("\n".join(text))
    mesh = read_mesh(tmp_path / "sheet.obj")
    np.testing.assert_array_equal(mesh.vertices, vertices)
    assert len(mesh.faces) == 2 * len(quads)
    assert len(mesh_surface(mesh).points) == len(vertices)


def test_ply_with_texture_keeps_its_vertices(tmp_path):
    """Texture coordinates of a triangle's corners, as photogrammetry writes them."""
    header = [
        "ply", "format ascii 1.0", f"element vertex {len(V)}",
        *(f"property double {a}" for a in "xyz"), f"element face {len(F)}",
        "property list uchar int vertex_indices",
        "property list uchar float texcoord", "end_header",
    ]  # fmt: skip
    rows = [" ".join(map(repr, row)) for row in V.tolist()]
    for i, (a, b, c) in enumerate(F):
        rows.append(f"3 {a} {b} {c} 6 " + " ".join([f"{i / len(F):.4f}", "0.5"] * 3))
    (tmp_path / "ball.ply").write_text("\n".join([*header, *rows, ""]))
    mesh = read_mesh(tmp_path / "ball.ply")
    np.testing.assert_array_equal(mesh.vertices, V)
    np.testing.assert_array_equal(mesh.faces, F)


def test_stl_corners_are_welded(tmp_path):
    BALL.export(tmp_path / "ball.stl")
    mesh = read_mesh(tmp_path / "ball.stl")
    assert mesh.vertices.shape == V.shape and mesh.is_watertight
    first = V[F].reshape(-1, 3)[0]
    np.testing.assert_allclose(mesh.vertices[0], first, atol=1e-7)


def with_flaws():
    """A degenerate triangle, one without area, a copy of another one."""
    faces = np.concatenate(
        [F, [[3, 3, 5]], [[len(V), len(V) + 1, 7]], F[9:10, [1, 2, 0]]]
    )
    return np.concatenate([V, V[7:8], V[7:8]]), faces


@pytest.mark.parametrize("make", [doubled, with_flaws])
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("offset", [0.0, 1e7])
def test_flawed_meshes_are_the_clean_surface(make, scale, offset):
    vertices, faces = make()
    shift = offset * np.array([1.0, -0.4, 0.2])
    mesh = trimesh.Trimesh(scale * (vertices + shift), faces, process=False)
    surface, clean = mesh_surface(mesh), mesh_surface(BALL)
    assert len(surface.points) == len(V) and len(surface.triangles) == len(F)
    tolerance = 1e-12 + 100 * 2.2e-16 * offset
    at = surface.points[surface.of_vertex] / scale - shift
    np.testing.assert_allclose(at, vertices, atol=tolerance)
    match = KDTree(V).query(surface.points / scale - shift)[1]
    areas = surface.areas / scale**2
    np.testing.assert_allclose(areas, clean.areas[match], rtol=10 * tolerance)
    np.testing.assert_allclose(
        surface.normals, clean.normals[match], atol=10 * tolerance
    )


@pytest.mark.parametrize("scale", [1e-9, 3e-4, 1e9])
@pytest.mark.parametrize("offset", [0.0, 1e7])
@pytest.mark.parametrize("kind", ["mesh", "cloud", "curve"])
def test_clouds_do_not_depend_on_unit_and_origin(kind, scale, offset):
    angle = 2 * np.pi * np.arange(60) / 60
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = circle if kind == "curve" else V
    shift = offset * np.array([1.0, -0.4, 0.2])[: points.shape[1]]

    def cloud(scale, shift):
        if kind == "mesh":
            mesh = trimesh.Trimesh(scale * (V + shift), F, process=False)
            return mr.PointCloud.from_mesh(mesh)
        return mr.PointCloud(scale * (points + shift), 1e-14 * points)

    one, other = cloud(1.0, 0 * shift), cloud(scale, shift)
    tolerance = 1e-11 + 2000 * 2.2e-16 * offset
    np.testing.assert_allclose(other.bendings * scale, one.bendings, atol=tolerance)
    np.testing.assert_allclose(other.slopes, one.slopes, atol=tolerance)
    m = points.shape[1] - 1
    np.testing.assert_allclose(other.areas / scale**m, one.areas, rtol=1e-3 + tolerance)
    places = 1.1 * points[:5] + 0.01
    ours = np.asarray(other.project(jnp.asarray(scale * (places + shift))))
    np.testing.assert_allclose(
        ours / scale - shift, one.project(jnp.asarray(places)), atol=tolerance
    )


@pytest.mark.parametrize("scale", [1e-9, 0.7, 1e9])
@pytest.mark.parametrize("offset", [0.0, 1e7])
def test_quadrature_does_not_depend_on_unit_and_origin(scale, offset):
    """A ball is full of ties: rounding must not decide them."""
    shift = offset * np.array([1.0, -0.4, 0.2])

    def domain(scale, shift):
        mesh = trimesh.Trimesh(scale * (V + shift), F, process=False)
        data = scale * (V[::9] + shift)
        return discretise(mr.PointCloud.from_mesh(mesh), 6, data, graded=True)

    one, other = domain(1.0, 0 * shift), domain(scale, shift)
    tolerance = 1e-12 + 100 * 2.2e-16 * offset
    points = other.points / scale - shift
    np.testing.assert_allclose(points, one.points, atol=tolerance)
    np.testing.assert_allclose(other.weights / scale**2, one.weights, atol=tolerance)


@pytest.mark.parametrize("centres", [13, 60, 400])
def test_small_meshes_are_integrated(centres):
    """12 points a centre, in the triangles where there are fewer vertices."""
    cloud = mr.PointCloud.from_mesh(BALL)
    domain = discretise(cloud, centres)
    assert len(domain.points) >= 12 * len(centres_of(cloud, centres).points)
    assert jnp.sum(domain.weights) == pytest.approx(BALL.area)
    radius = jnp.linalg.norm(domain.points, axis=1, keepdims=True)
    np.testing.assert_allclose(radius, 1.0, atol=0.01)
    x, y, z = (domain.points / radius).T
    for exact, values in ((1 / 3, x**2), (1 / 5, y**4), (1 / 15, x**2 * z**2)):
        mean = jnp.sum(domain.weights * values) / BALL.area
        assert mean == pytest.approx(exact, rel=0.02)


@pytest.mark.parametrize("offset", [0.0, 5e6])
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e6])
@pytest.mark.parametrize("kind", ["ply", "obj", "off", "stl"])
def test_written_as_exactly_as_needed(tmp_path, kind, scale, offset):
    vertices = scale * (V + [offset, offset / 7, 0.1])
    mesh = trimesh.Trimesh(vertices, F, process=False)
    path = write_mesh(mesh, tmp_path / f"ball.{kind}")
    assert path == tmp_path / f"ball.{kind}"
    found = read_mesh(path)
    corners = found.vertices[found.faces] - vertices[F]
    exact = kind in ("obj", "off") or offset > 0
    assert np.abs(corners).max() <= (0.0 if exact else 2e-7 * scale)
    if kind != "stl":
        np.testing.assert_array_equal(found.faces, F)


def test_formats_of_single_precision(tmp_path):
    near = write_mesh(BALL, tmp_path / "ball.glb")
    assert near.suffix == ".glb" and near.is_file()
    far = trimesh.Trimesh(V + 1e6, F, process=False)
    path = write_mesh(far, tmp_path / "far.glb")
    assert path == tmp_path / "far.ply"
    np.testing.assert_array_equal(read_mesh(path).vertices, V + 1e6)


def test_largest_component_keeps_numbers():
    """The smaller ball comes first, its vertices stay."""
    small = V * 0.1 + [5.0, 0, 0]
    vertices, faces = doubled()
    both = np.concatenate([small, vertices])
    mesh = trimesh.Trimesh(
        both, np.concatenate([F[:40], faces + len(V)]), process=False
    )
    mesh = largest_component(mesh)
    np.testing.assert_array_equal(mesh.vertices, both)
    cloud = mr.PointCloud.from_mesh(mesh)
    assert cloud.of_vertex is not None and len(cloud.points) == len(V)
    np.testing.assert_array_equal(cloud.points[cloud.of_vertex][len(V) :], vertices)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_winding(share):
    """Up to a quarter the others decide, then that a ball's normals point outwards."""
    turned = np.random.default_rng(0).random(len(F)) < share
    faces = np.where(turned[:, None], F[:, ::-1], F)
    mesh = wound_alike(trimesh.Trimesh(V, faces, process=False))
    outward = np.sum(mesh.face_normals * V[F].mean(axis=1), axis=1)
    assert np.all(outward * (-1 if share == 0.9 else 1) > 0)


def test_one_sided():
    n = 30
    turn = np.linspace(0, 2 * np.pi, n, endpoint=False)[:, None]
    across = np.array([-0.3, 0.3]) * np.cos(turn / 2)
    up = np.array([-0.3, 0.3]) * np.sin(turn / 2)
    strip = np.stack([(1 + across) * np.cos(turn), (1 + across) * np.sin(turn), up], -1)
    k = np.arange(2 * n).reshape(n, 2)
    after = np.concatenate([k[1:], k[:1, ::-1]])
    faces = np.concatenate(
        [np.c_[k[:, 0], after[:, 0], k[:, 1]], np.c_[k[:, 1], after[:, 0], after[:, 1]]]
    )
    mesh = trimesh.Trimesh(strip.reshape(-1, 3), faces, process=False)
    with pytest.raises(ValueError, match="one side only"):
        mr.PointCloud.from_mesh(mesh)


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.nan * V, F, "all 320 triangles have vertices of NaN"),
        (V, F + 3, "triangle .* has vertices .*, but there are 162"),
        (0 * V, F, "all 320 triangles are degenerate"),
    ],
    ids=["NaN", "beyond", "point"],
)
def test_bad_meshes(vertices, faces, message):
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    with pytest.raises(ValueError, match="mesh: " + message):
        mr.PointCloud.from_mesh(mesh)


def sheet(curve, width, n_across):
    """A strip swept along a curve in the plane (n, 2), with its triangles."""
    n, z = len(curve), np.linspace(0, width, n_across)
    points = np.concatenate(
        [np.repeat(curve, n_across, axis=0), np.tile(z, n)[:, None]], axis=1
    )
    k = np.arange(n * n_across).reshape(n, n_across)
    a, b, c, d = (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:])
    faces = np.concatenate(
        [np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    )
    return trimesh.Trimesh(points, faces, process=False)


def largest_bendings(cloud):
    values = np.linalg.eigvalsh(np.asarray(cloud.bendings))
    return np.take_along_axis(values, np.abs(values).argmax(axis=1)[:, None], axis=1)[
        :, 0
    ]


def test_layers_nearer_than_points_do_not_mix():
    """A sheet rolled up: layers a fifth of a spacing apart, with normals to the same
    side."""
    gap, spacing = 0.02, 0.1
    turn = np.arange(0, 6 * np.pi, spacing)
    r = 1 + gap * turn / (2 * np.pi)
    mesh = sheet(np.c_[r * np.cos(turn), r * np.sin(turn)], 1.0, 11)
    bend = largest_bendings(mr.PointCloud.from_mesh(mesh))
    exact = np.repeat(1 / r, 11)
    np.testing.assert_allclose(np.abs(bend), exact, rtol=0.05)


@pytest.mark.parametrize("half", [0.01, 0.0])
def test_closed_lips(half):
    """Two sheets back to back, bent alike, as near as lips: at `half` 0 they touch."""
    x = np.linspace(-1, 1, 21)
    mid, slope = np.c_[x, 0.5 * x**2], np.c_[-x, 0 * x + 1]
    normal = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    rim = half * np.sqrt(1 - (x / 1.0) ** 2)[:, None]
    upper, lower = mid + rim * normal, mid - rim * normal
    curve = np.concatenate([upper, lower[-2:0:-1]])
    mesh = sheet(np.concatenate([curve, curve[:1]]), 1.0, 11)
    keep = np.arange(len(mesh.vertices))
    keep[-11:] = np.arange(11)  # the last row is the first
    mesh = trimesh.Trimesh(mesh.vertices, keep[mesh.faces], process=False)
    cloud = mr.PointCloud.from_mesh(mesh)
    of_row = np.asarray(cloud.of_vertex)[:-11].reshape(-1, 11)[:, 2:-2]
    at = np.asarray(cloud.points)[of_row][:, :, 0]
    inner = np.abs(at[:, 0]) < 0.7
    bend, up = (
        largest_bendings(cloud)[of_row],
        np.asarray(cloud.normals)[of_row][..., 1],
    )
    exact = np.sign(up) / (1 + at**2) ** 1.5
    np.testing.assert_allclose(bend[inner], exact[inner], rtol=0.05, atol=0.02)


def test_a_scan_of_a_face(data_folder):
    """Lips, eyelids and nostrils: winding is consistent, so it is sound."""
    cloud = mr.PointCloud.from_mesh(data_folder / "meshes" / "face_demo_10K.obj")
    assert cloud.points.shape == (10000, 3)
    assert np.all(np.isfinite(cloud.bendings))
