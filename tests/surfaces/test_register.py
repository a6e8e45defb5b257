"""Registration of surfaces with known maps."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

import manireg as mr
from manireg._cli.app import app


def bend(p):
    """A smooth map of space that no affine map comes near."""
    return p * [1.0, 1.2, 0.8] + 0.15 * np.sin(2 * p[:, [1, 2, 0]])


BALL = trimesh.creation.icosphere(subdivisions=4)
BENT = trimesh.Trimesh(bend(BALL.vertices), BALL.faces, process=False)
LANDMARKS = np.arange(40)  # the vertices of the coarsest levels


@pytest.mark.slow
@pytest.mark.parametrize("geometry", ["ambient", "intrinsic"])
def test_bent_ball(geometry):
    found = mr.register(
        BALL, BENT, LANDMARKS, LANDMARKS, geometry=geometry, centres=80, progress=False
    )
    error = np.linalg.norm(found.vertices - BENT.vertices, axis=1)
    linear = np.linalg.lstsq(
        np.c_[BALL.vertices[LANDMARKS], np.ones(40)], BENT.vertices[LANDMARKS]
    )[0]
    affine = np.c_[BALL.vertices, np.ones(len(error))] @ linear
    assert error.mean() < 0.3 * np.linalg.norm(affine - BENT.vertices, axis=1).mean()
    assert found.landmark_errors.max() < 0.05
    surface = mr.PointCloud.from_mesh(BENT)
    on_it = surface.signed_distance(jnp.asarray(found.vertices))
    assert np.abs(on_it).max() < 1e-3
    assert found.mesh(0.5).is_watertight
    assert found.stretch().shape == (len(BALL.faces),)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "both"), [("centres", (20, 80)), ("tension", (0.0, 1e3))]
)
def test_chosen_is_what_predicts_landmarks(name, both):
    """The better of two, found without knowing the truth."""
    options = {"centres": 80, "progress": False}
    found = [
        mr.register(BALL, BENT, LANDMARKS, LANDMARKS, 1e-6, **options | {name: value})
        for value in (*both, both)
    ]
    errors = [np.linalg.norm(f.vertices - BENT.vertices, axis=1).mean() for f in found]
    assert errors[0] != errors[1]
    # each ends where the objective falls by less than a thousandth
    np.testing.assert_allclose(errors[2], min(errors[:2]), rtol=1e-3)
    assert found[2].cv is not None and found[2].cv.scores.shape == (40, 1)


def off_surface(p):
    return np.where(np.arange(len(p))[:, None] == 2, 2 * p, p)


PLACES = BALL.vertices[LANDMARKS]


@pytest.mark.parametrize(
    ("ours", "theirs", "message"),
    [
        (LANDMARKS[:3], LANDMARKS[:3], "at least 5 pairs .* found 3"),
        (LANDMARKS, LANDMARKS[:-1], "found 40 on the source and 39 on the target"),
        (LANDMARKS + 2600, LANDMARKS, "source_landmarks: vertex 2600 does not exist"),
        (PLACES * np.nan, LANDMARKS, "source_landmarks: NaN or infinity"),
        (off_surface(PLACES), LANDMARKS, "source_landmarks: landmark 2 lies .* off"),
        (PLACES[:, :2], LANDMARKS, r"expected vertex numbers \(l,\) or positions"),
    ],
    ids=["few", "lengths", "vertex", "NaN", "off", "shape"],
)
def test_bad_landmarks(ours, theirs, message):
    with pytest.raises(ValueError, match=message):
        mr.register(BALL, BALL, ours, theirs, 1e-3)


def test_bad_geometry():
    with pytest.raises(ValueError, match="geometry: expected 'ambient' or 'intr"):
        mr.register(BALL, BALL, LANDMARKS, LANDMARKS, geometry="outer")


def command(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


@pytest.mark.slow
@pytest.mark.parametrize("form", ["vertices", "positions"])
def test_command(tmp_path, form):
    """Meshes written by trimesh, in three formats."""
    BALL.export(tmp_path / "ball.ply")
    BENT.export(tmp_path / "bent.obj" if form == "vertices" else tmp_path / "bent.stl")
    bent = next(tmp_path.glob("bent.*"))
    if form == "vertices":
        header, rows = "source,target", np.stack([LANDMARKS, LANDMARKS], axis=1)
    else:
        header = "sx,sy,sz,tx,ty,tz"
        rows = np.concatenate([PLACES, BENT.vertices[LANDMARKS]], axis=1)
    pairs, out = tmp_path / "pairs.csv", tmp_path / "out.ply"
    np.savetxt(pairs, rows, delimiter=",", header=header, comments="", fmt="%.12g")
    run = command(
        "register", tmp_path / "ball.ply", bent, "--landmarks", pairs, "--out", out,
        "--lam", 1e-5, "--centres", 80, "--picture", tmp_path / "out.png",
        "--morph", 0.5,
    )  # fmt: skip
    assert run.exit_code == 0, run.output
    assert "landmark errors" in run.output
    found = trimesh.load_mesh(out)
    assert len(found.faces) == len(BALL.faces)
    gap = np.linalg.norm(found.vertices - BENT.vertices, axis=1)
    assert gap.mean() < 0.02
    assert len(trimesh.load_mesh(tmp_path / "out_morph.ply").faces) == len(BALL.faces)
    assert (tmp_path / "out.png").stat().st_size > 20_000


def test_command_names_mistakes(tmp_path):
    BALL.export(tmp_path / "ball.ply")
    (tmp_path / "pairs.csv").write_text("source,aim\n1,2\n")
    arguments = ["register", tmp_path / "ball.ply", tmp_path / "ball.ply"]
    run = command(*arguments, "--landmarks", tmp_path / "pairs.csv")
    assert run.exit_code == 2 and "has no column `sx`" in run.output


@pytest.mark.slow
def test_open_surfaces_and_a_target_too_small():
    """A cap onto a smaller cap with a hole: points that belong beyond the edge stay near
    the target's, nothing is lost."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    z = ball.triangles_center[:, 2]
    hole = np.linalg.norm(ball.triangles_center[:, :2], axis=1) < 0.2
    source, target = ball.copy(), ball.copy()
    source.update_faces(z > -0.2)
    target.update_faces((z > 0.1) & ~hole)
    for mesh in (source, target):
        mesh.remove_unreferenced_vertices()
    at = np.asarray(target.vertices)[::40]
    nearest = np.linalg.norm(source.vertices[:, None] - at, axis=2).argmin(axis=0)
    found = mr.register(source, target, nearest, at, 1e-3, centres=80)
    assert np.all(np.isfinite(found.vertices))
    assert np.allclose(np.linalg.norm(found.vertices, axis=1), 1, atol=0.05)
    kept = source.vertices[:, 2] > 0.2
    gap = np.linalg.norm(found.vertices - source.vertices, axis=1)
    assert np.mean(gap[kept]) < 0.02 and np.max(gap) < 0.3


def strip(uv, rolled: bool):
    """A grid of a strip of length 6.7, flat or rolled up to a spiral by arc length."""
    u, v = uv.reshape(-1, 2).T
    angle = np.linspace(0, 9.5, 20001)
    radius = 0.5 + angle / (6 * np.pi)  # turns are a third apart
    along = np.cumsum(np.hypot(radius, 1 / (6 * np.pi))) * angle[1]
    at = np.interp(u, along, angle)
    circle = np.stack([np.cos(at), np.sin(at)], axis=1)
    spiral = np.interp(at, angle, radius)[:, None] * circle
    points = np.c_[spiral, v] if rolled else np.c_[u, v, 0 * u]
    n, m = uv.shape[:2]
    corner = (np.arange(n - 1)[:, None] * m + np.arange(m - 1)).ravel()
    halves = [
        [corner, corner + m, corner + 1],
        [corner + 1, corner + m, corner + m + 1],
    ]
    faces = np.concatenate([np.transpose(half) for half in halves])
    return trimesh.Trimesh(points, faces, process=False)


@pytest.mark.slow
def test_rolled_up():
    """Lambda chosen: the path that comes down from stiff maps stays on a wrong turn."""
    axes = np.linspace(0, 6.7, 136), np.linspace(0, 1.5, 31)
    uv = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    source, target = strip(uv, rolled=False), strip(uv, rolled=True)
    landmarks = np.random.default_rng(0).choice(len(source.vertices), 25, replace=False)
    options = {"geometry": "intrinsic", "centres": 100, "progress": False}
    found = mr.register(source, target, landmarks, landmarks, **options)
    error = np.linalg.norm(found.vertices - target.vertices, axis=1)
    assert np.quantile(error, 0.99) < 0.005
