"""Registration of meshes as people have them: the same map as that of the clean mesh,
with the numbers of the given one. Small meshes of one shape, so that programs are shared.
"""

import re
import warnings
from typing import Any

import broken_meshes
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
import trimesh
from ball_meshes import F, V, doubled, textured_obj, unused_obj
from typer.testing import CliRunner

import manireg as mr
from manireg._cli.app import app
from manireg._surfaces import landmark_fit, register as _register
from manireg.meshes import read_mesh, write_mesh

W = V * [1.0, 1.2, 0.8] + 0.15 * np.sin(2 * V[:, [1, 2, 0]])
LANDMARKS = np.arange(0, 162, 8)


def mesh(vertices, faces=F):
    return trimesh.Trimesh(vertices, faces, process=False)


def register(
    source, target, ours: Any = LANDMARKS, theirs: Any = LANDMARKS, lam: float = 1e-3
):
    return mr.register(source, target, ours, theirs, lam, centres=20, progress=False)


@pytest.fixture(scope="module")
def clean():
    found = register(mesh(V), mesh(W))
    assert np.linalg.norm(found.vertices - W, axis=1).mean() < 0.03
    return found


def obj(folder, make):
    path = folder / "ball.obj"
    path.write_text("\n".join(make()[0]))
    return path


def test_texture_seam(clean, tmp_path):
    found = register(obj(tmp_path, textured_obj), mesh(W))
    np.testing.assert_allclose(found.vertices, clean.vertices, atol=1e-12)
    np.testing.assert_array_equal(found.source_vertices, V)
    np.testing.assert_array_equal(found.faces, F)


def test_unused_vertices(clean, tmp_path):
    """They go with the nearest vertex in use."""
    path = obj(tmp_path, unused_obj)
    found = register(path, mesh(W), ours=LANDMARKS + 5)
    np.testing.assert_allclose(found.vertices[5:-2], clean.vertices, atol=1e-12)
    nearest = np.argmin(np.linalg.norm(V - [9.0, 0, 0], axis=1))
    for i in (0, 4, -1):
        np.testing.assert_array_equal(found.vertices[i], found.vertices[5 + nearest])
    np.testing.assert_array_equal(found.source_vertices[0], [9.0, 0, 0])
    np.testing.assert_array_equal(found.faces, read_mesh(path).faces)
    assert found.mesh(0.5).area > 1


def test_doubled_vertices(clean):
    """Of source and target; either copy may be the landmark."""
    vertices, faces = doubled()
    other = LANDMARKS + len(V) * (np.arange(len(LANDMARKS)) % 2)
    target = mesh(np.concatenate([W, W]), faces)
    found = register(mesh(vertices, faces), target, other, other)
    np.testing.assert_array_equal(found.vertices[: len(V)], found.vertices[len(V) :])
    np.testing.assert_allclose(found.vertices[: len(V)], clean.vertices, atol=0.03)
    np.testing.assert_array_equal(found.faces, faces)


def test_a_cloud_of_a_mesh_has_its_numbers(clean, tmp_path):
    cloud = mr.PointCloud.from_mesh(obj(tmp_path, unused_obj))
    found = register(cloud, mesh(W), ours=LANDMARKS + 5)
    np.testing.assert_allclose(found.vertices[5:-2], clean.vertices, atol=1e-12)


QUICK = ("soup", "with_nan_triangles", "specks, far_away")
CASES = [
    name if name in QUICK else pytest.param(name, marks=pytest.mark.slow)
    for name in broken_meshes.ZOO
]


@pytest.fixture(scope="module")
def sound():
    ours, theirs = mesh(broken_meshes.W), mesh(V)
    return register(ours, theirs), register(theirs, ours)


@pytest.mark.filterwarnings("ignore:(source|target). ")
@pytest.mark.parametrize("name", CASES)
def test_broken_meshes(sound, name):
    """The map from and onto a broken mesh is that of the sound one."""
    found = broken_meshes.broken(broken_meshes.ZOO[name])
    given, numbers = mesh(found.vertices, found.faces), found.numbers
    tolerance = 1e-6 * float(np.linalg.norm(np.ptp(V, axis=0)))
    lam = 1e-3 * found.scale**2
    there = register(given, mesh(V), ours=numbers[LANDMARKS], lam=lam).vertices
    assert np.all(np.isfinite(there)) and len(there) == len(found.vertices)
    np.testing.assert_allclose(there[numbers], sound[0].vertices, atol=tolerance)
    back = register(mesh(V), given, theirs=numbers[LANDMARKS])
    at = back.vertices / found.scale - found.shift
    np.testing.assert_allclose(at, sound[1].vertices, atol=tolerance)


@pytest.mark.parametrize("scale", [1e-9, 0.3, 1e9])
def test_scale(clean, scale):
    found = register(mesh(scale * V), mesh(scale * W), lam=1e-3 * scale**2)
    np.testing.assert_allclose(found.vertices / scale, clean.vertices, atol=1e-10)
    np.testing.assert_allclose(found.stretch(), clean.stretch(), rtol=1e-8)


@pytest.mark.parametrize(
    ("ours", "theirs"), [(1e7, 0.0), (0.0, 1e7), (5e5, 1e7)], ids=str
)
def test_origin(clean, ours, theirs):
    away = np.array([1.0, -0.3, 0.7])
    found = register(mesh(V + ours * away), mesh(W + theirs * away))
    tolerance = 100 * 2.2e-16 * max(ours, theirs)
    at = found.vertices - theirs * away
    np.testing.assert_allclose(at, clean.vertices, atol=tolerance)


def test_stl_has_no_vertex_numbers(clean, tmp_path):
    path = write_mesh(mesh(V), tmp_path / "ball.stl")
    with pytest.raises(ValueError, match="STL files do not number vertices"):
        register(path, mesh(W))
    found = register(path, mesh(W), ours=V[LANDMARKS])
    assert len(found.vertices) == len(V) and found.mesh().is_watertight


@pytest.mark.parametrize("form", ["vertices", "positions"])
def test_command(clean, tmp_path, form):
    """The same as in Python, in files."""
    write_mesh(mesh(V), tmp_path / "ball.ply")
    write_mesh(mesh(W), tmp_path / "bent.obj")
    if form == "vertices":
        header, rows = "source,target", np.stack([LANDMARKS, LANDMARKS], axis=1)
    else:
        header = "sx,sy,sz,tx,ty,tz"
        rows = np.concatenate([V[LANDMARKS], W[LANDMARKS]], axis=1)
    pairs, out = tmp_path / "pairs.csv", tmp_path / "out.ply"
    np.savetxt(pairs, rows, delimiter=",", header=header, comments="", fmt="%.17g")
    arguments = [
        "register", tmp_path / "ball.ply", tmp_path / "bent.obj", "--landmarks", pairs,
        "--out", out, "--lam", 1e-3, "--centres", 20, "--morph", 0.5,
        "--picture", tmp_path / "out.png",
    ]  # fmt: skip
    run = CliRunner().invoke(app, [str(a) for a in arguments])
    assert run.exit_code == 0, run.output
    assert "landmark errors" in run.output
    ours, theirs = (LANDMARKS,) * 2 if form == "vertices" else np.split(rows, 2, axis=1)
    again = register(tmp_path / "ball.ply", tmp_path / "bent.obj", ours, theirs)
    assert np.linalg.norm(again.vertices - clean.vertices, axis=1).mean() < 0.01
    found = read_mesh(out)
    np.testing.assert_allclose(found.vertices, again.vertices, atol=1e-6)
    np.testing.assert_array_equal(found.faces, F)
    half = read_mesh(tmp_path / "out_morph.ply")
    np.testing.assert_allclose(half.vertices, again.mesh(0.5).vertices, atol=1e-6)
    assert (tmp_path / "out.png").stat().st_size > 20_000


def test_command_with_landmark_files(clean, tmp_path):
    """A file a surface, in the orders and formats of two programs."""
    write_mesh(mesh(V), tmp_path / "ball.obj")
    write_mesh(mesh(W), tmp_path / "bent.obj")
    rows = [f"p{i},{i}" for i in LANDMARKS]
    (tmp_path / "a.csv").write_text("\n".join(["name,vertex", *rows, "extra,1"]))
    points = [
        f'<point name="P{i}" x="{x!r}" y="{y!r}" z="{z!r}"/>'
        for i, (x, y, z) in zip(LANDMARKS, W[LANDMARKS].tolist())
    ]
    (tmp_path / "b.pp").write_text(
        f"<PickedPoints>{''.join(points[::-1])}</PickedPoints>"
    )
    arguments = [
        "register", tmp_path / "ball.obj", tmp_path / "bent.obj",
        "--landmarks", tmp_path / "a.csv", "--target-landmarks", tmp_path / "b.pp",
        "--out", tmp_path / "out.ply", "--lam", 1e-3, "--centres", 20,
    ]  # fmt: skip
    run = CliRunner().invoke(app, [str(a) for a in arguments])
    assert run.exit_code == 0, run.output
    assert "21 pairs; left out are those only on the source: 'extra'" in run.output
    assert "bent.obj: 162 vertices, 320 triangles, extent " in run.output
    found = read_mesh(tmp_path / "out.ply")
    np.testing.assert_allclose(found.vertices, clean.vertices, atol=1e-5)


@pytest.mark.parametrize(
    ("name", "both"),
    [
        ("tension", (1e3, 1.0)),
        pytest.param("centres", (5, 20), marks=pytest.mark.slow),
    ],
)
def test_chosen_is_what_predicts_landmarks(clean, name, both):
    """The better of two, found without knowing the truth."""
    options = {"centres": 20, "progress": False, name: both}
    found = mr.register(mesh(V), mesh(W), LANDMARKS, LANDMARKS, 1e-3, **options)
    # each ends where the objective falls by less than a thousandth
    np.testing.assert_allclose(found.vertices, clean.vertices, atol=5e-3)
    assert found.cv is not None and found.cv.scores.shape == (len(LANDMARKS), 1)


class Reached(Exception):
    pass


@pytest.fixture
def no_fit(monkeypatch):
    """Stops where the checks have passed."""

    def stop(*_, **__):
        raise Reached

    monkeypatch.setattr(landmark_fit, "make_problem", stop)


FLIP = np.array([-1.0, 1, 1])


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize(
    ("target", "message"),
    [
        (
            mesh(W * FLIP, F[:, ::-1]),
            "a mirror image of the source by its landmarks; tri",
        ),
        (mesh(W * FLIP), "a mirror image .* and its triangles are inside out"),
        (mesh(W, F[:, ::-1]), "by the landmarks its normals point to the other side"),
    ],
    ids=["mirrored", "mirrored vertices", "inside out"],
)
@pytest.mark.parametrize("positions", [False, True])
def test_orientation_and_its_cure(no_fit, target, message, positions, scale):
    target = mesh(scale * target.vertices + 3 * scale, target.faces)
    theirs = target.vertices[LANDMARKS] if positions else LANDMARKS
    with pytest.raises(ValueError, match="target: " + message) as error:
        register(mesh(V), target, theirs=theirs)
    code = re.findall("`(.*?)`", str(error.value))[0]
    exec(code, {"mesh": target, "np": np})
    theirs = target.vertices[LANDMARKS] if positions else LANDMARKS
    with pytest.raises(Reached):
        register(mesh(V), target, theirs=theirs)


def test_orientation_of_sheets(no_fit):
    """A sheet onto a half cylinder: landmarks of the one lie in a plane."""
    n, k = 12, np.arange(144).reshape(12, 12)
    x, y = np.meshgrid(*[np.linspace(0, 1, n)] * 2, indexing="ij")
    flat = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    bent = np.stack([np.sin(np.pi * (x - 0.5)), y, np.cos(np.pi * (x - 0.5))], -1)
    a, b, c, d = (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:])
    faces = np.concatenate(
        [np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    )
    source, landmarks = mesh(flat, faces), np.arange(0, 144, 13)
    landmarks = np.append(landmarks, [11, 132, 5])
    bent = bent.reshape(-1, 3)
    with pytest.raises(Reached):
        register(source, mesh(bent, faces), landmarks, landmarks)
    for wrong in (mesh(bent, faces[:, ::-1]), mesh(flat * FLIP, faces[:, ::-1])):
        with pytest.raises(ValueError, match="target: .* inside out"):
            register(source, wrong, landmarks, landmarks)


@pytest.mark.parametrize("offset", [0.0, 1e6])
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_landmarks_on_one_line(no_fit, scale, offset):
    source = mesh(scale * (V + offset))
    line = np.array([np.argmin(np.linalg.norm(V - [0, 0, z], axis=1)) for z in (1, -1)])
    with pytest.raises(ValueError, match="source_landmarks: all on one line"):
        register(source, mesh(W), np.repeat(line, 3), LANDMARKS[:6])
    with pytest.raises(ValueError, match="target_landmarks: all on one line"):
        register(mesh(W), source, LANDMARKS[:6], np.repeat(line, 3))
    with pytest.raises(Reached):
        register(source, mesh(W))


def test_what_is_wrong_is_named(no_fit):
    two = mesh(np.concatenate([V, V + 5]), np.concatenate([F, F + len(V)]))
    with pytest.raises(ValueError, match="target: all 320 triangles are degenerate"):
        register(mesh(V), mesh(0 * V))
    with pytest.raises(
        ValueError, match="expected a trimesh.Trimesh or a file, found S"
    ):
        mr.PointCloud.from_mesh(two.scene())
    with pytest.raises(ValueError, match=r"source: expected shape \(n, 3\), found"):
        register(V[:, :2], two)


def test_a_fit_that_had_not_settled_is_told(clean):
    """What `register` says of the fit it keeps."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        _register._check_result(clean.model)
    unsettled = optx.RESULTS.nonlinear_max_steps_reached
    model = eqx.tree_at(lambda m: m.result, clean.model, unsettled)
    with pytest.warns(
        UserWarning, match="had not settled after .* Take a larger `lam`"
    ):
        _register._check_result(model)
    nothing = jnp.full_like(model.coefficients, jnp.nan)
    model = eqx.tree_at(lambda m: m.coefficients, model, nothing)
    with pytest.raises(RuntimeError, match="ends in NaN; take a larger `lam`"):
        _register._check_result(model)


@pytest.mark.parametrize("max_steps", [1, pytest.param(6, marks=pytest.mark.slow)])
def test_steps_on_a_point_cloud_are_counted(max_steps):
    """Data all over a circle: no fit settles in so few."""
    angle, x = np.linspace(0, 2 * np.pi, 40, endpoint=False), np.linspace(0, 1, 12)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    cloud, y = mr.PointCloud(circle, circle), circle[17 * np.arange(12) % 40]
    problem = mr.make_problem(mr.Interval(0, 1), cloud, x, y, centres=8)
    options = {"max_steps": max_steps, "starts": (1.0,)}
    model = mr.solve(problem, 1e-4, throw=False, **options)
    assert int(model.stats["num_trials"]) <= max_steps
    if max_steps == 1:
        assert model.result == optx.RESULTS.nonlinear_max_steps_reached
        with pytest.raises(RuntimeError):
            mr.solve(problem, 1e-4, **options)
