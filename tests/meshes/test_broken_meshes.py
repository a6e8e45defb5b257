"""Broken meshes are the sound surface, with their own vertex numbers."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from broken_meshes import EXPORTS, FILES, SOUND, ZOO, F, N, W, broken

import manireg as mr

QUERIES = W[::5] * 1.03 + 0.01
SIZE = float(np.linalg.norm(np.ptp(W, axis=0)))


@pytest.fixture(scope="module")
def sound():
    return mr.load_surface(trimesh.Trimesh(W, F, process=False))


def close(found, sound, tolerance=1e-6):
    np.testing.assert_allclose(found, sound, atol=tolerance * SIZE)


def assert_same(found: mr.Surface, mesh, sound: mr.Surface):
    numbers, scale, shift = mesh.numbers, mesh.scale, mesh.shift
    np.testing.assert_array_equal(found.vertices, mesh.vertices)
    np.testing.assert_array_equal(found.of_vertex[numbers], np.arange(N))
    assert np.all(np.isfinite(found.places))
    cloud = found.cloud
    assert np.shape(cloud.points) == (N, 3)
    close(np.asarray(cloud.points) / scale - shift, W)
    np.testing.assert_allclose(cloud.normals, sound.cloud.normals, atol=1e-6)
    areas = np.asarray(cloud.areas) / scale**2
    np.testing.assert_allclose(areas, sound.cloud.areas, rtol=1e-5)
    there = np.asarray(cloud.project(jnp.asarray(scale * (QUERIES + shift))))
    close(there / scale - shift, sound.cloud.project(jnp.asarray(QUERIES)))
    assert found.size / scale == pytest.approx(SIZE)


@pytest.mark.parametrize("name", ZOO)
def test_zoo(sound, name):
    mesh = broken(ZOO[name])
    given = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert_same(mr.load_surface(given), mesh, sound)


@pytest.mark.parametrize("name", FILES)
def test_files(sound, tmp_path, name):
    (tmp_path / name).write_text(FILES[name], newline="")
    assert_same(mr.load_surface(tmp_path / name), SOUND, sound)


@pytest.mark.parametrize("name", EXPORTS)
def test_exports_of_trimesh(sound, tmp_path, name):
    trimesh.Trimesh(W, F, process=False).export(tmp_path / name)
    found = mr.load_surface(tmp_path / name)
    ours = found.cloud.project(jnp.asarray(QUERIES))
    close(ours, sound.cloud.project(jnp.asarray(QUERIES)))
    assert found.numbered == (not name.endswith("stl"))


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("unused", "7 vertices of no triangle that is kept (first: 0)"),
        ("with_nan_triangles", "1 vertices of NaN or infinity (first: 162)"),
        ("soup", f"{F.size - N} vertices at the place of another"),
        ("degenerate", "3 degenerate triangles (first: 0)"),
        ("copies", "26 copies of triangles (first: 320)"),
        ("specks", "2 components of less than 1 % of the area: left out (0.0"),
        ("some_turned", " triangles wound against their neighbours"),
    ],
)
def test_report(name, line):
    mesh = broken(ZOO[name])
    given = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert line in str(mr.load_surface(given).report)


def test_a_vertex_without_a_place_goes_with_a_neighbour():
    vertices = W.copy()
    vertices[40] = np.nan
    found = mr.load_surface(trimesh.Trimesh(vertices, F, process=False))
    beside = np.unique(F[np.any(F == 40, axis=1)])
    assert np.isin(found.of_vertex[40], found.of_vertex[np.setdiff1d(beside, [40])])
    assert np.all(np.isfinite(found.places))
    assert "open edges: as they are, in 1 rim" in str(found.report)


def test_components_of_a_size_are_kept():
    both = np.concatenate([W, 0.5 * W + 5.0])
    given = trimesh.Trimesh(both, np.concatenate([F, F + N]), process=False)
    found = mr.load_surface(given)
    assert found.components == 2 and len(found.cloud.points) == 2 * N
    assert "2 components that do not touch: kept (80 %, 20 %" in str(found.report)
    largest = found.largest()
    assert largest.components == 1 and len(largest.cloud.points) == N
    np.testing.assert_array_equal(largest.of_vertex[:N], np.arange(N))
    np.testing.assert_array_equal(largest.vertices, both)
    assert mr.load_surface(given, least_share=0.3).components == 1


def test_a_tangle_in_a_sound_surface(sound):
    """A small part with one side only, hanging at an edge: left as it is, and told."""
    turn = np.linspace(0, 2 * np.pi, 6, endpoint=False)[:, None]
    across = np.array([-0.3, 0.3])
    strip = np.stack(
        [
            (1 + across * np.cos(turn / 2)) * np.cos(turn),
            (1 + across * np.cos(turn / 2)) * np.sin(turn),
            across * np.sin(turn / 2),
        ],
        -1,
    ).reshape(-1, 3)
    k = np.arange(12).reshape(6, 2)
    after = np.concatenate([k[1:], k[:1, ::-1]])
    loop = np.concatenate(
        [np.c_[k[:, 0], after[:, 0], k[:, 1]], np.c_[k[:, 1], after[:, 0], after[:, 1]]]
    )
    strip = 0.01 * (strip - strip[0]) + W[0]
    loop = np.where(loop == 0, -N, loop)  # the first corner is vertex 0
    vertices, faces = np.concatenate([W, strip]), np.concatenate([F, loop + N])
    found = mr.load_surface(trimesh.Trimesh(vertices, faces, process=False))
    assert "where the surface has one side only" in str(found.report)
    away = QUERIES[np.linalg.norm(QUERIES - W[0], axis=1) > 1.0]
    ours = found.cloud.project(jnp.asarray(away))
    close(ours, sound.cloud.project(jnp.asarray(away)))


def test_three_triangles_at_an_edge(sound):
    """A fin: it changes nothing elsewhere."""
    fin = np.concatenate([W, 1.1 * W[F[0]].mean(axis=0)[None]])
    faces = np.concatenate([F, [[F[0, 0], F[0, 1], N]]])
    found = mr.load_surface(trimesh.Trimesh(fin, faces, process=False))
    assert "1 edges of three triangles or more" in str(found.report)
    away = QUERIES[np.linalg.norm(QUERIES - fin[-1], axis=1) > 1.0]
    ours = found.cloud.project(jnp.asarray(away))
    close(ours, sound.cloud.project(jnp.asarray(away)))


def test_numbers_from_one():
    with pytest.raises(ValueError, match="Are they numbered from 1?.*`mesh.faces - 1`"):
        mr.load_surface(trimesh.Trimesh(W, F + 1, process=False))
