"""What a registration says of itself, against counts by hand, matrices and brute force."""

import dataclasses
import json
import re
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest
import trimesh
from matplotlib.image import imread
from typer.testing import CliRunner

import manireg as mr
from manireg._cli.app import app
from manireg._surfaces import folds
from manireg._surfaces.folds import agreement, without_folds
from manireg._surfaces.mesh_distance import mesh_distance

BALL = trimesh.creation.icosphere(subdivisions=3)
MATRIX = np.array([[1.0, 0.2, 0.0], [0.0, 1.3, 0.1], [0.1, 0.0, 0.8]])
OVAL = trimesh.Trimesh(BALL.vertices @ MATRIX.T, BALL.faces, process=False)
LANDMARKS = np.arange(42)


def sheet(n=12):
    x, y = (a.ravel() for a in np.meshgrid(*[np.arange(n + 1.0)] * 2, indexing="ij"))
    k = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]
    faces = np.concatenate(
        [np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    )
    return np.stack([x, y, 0 * x], 1), faces


def test_folds_are_those_made_by_hand():
    """One vertex is pulled over its right neighbour: of its six triangles those on the
    right turn over; two vertices at one place: two triangles collapse."""
    vertices, faces = sheet()
    target = mr.PointCloud.from_mesh(trimesh.Trimesh(vertices, faces, process=False))
    assert np.all(agreement(vertices, faces, target) > 0.999)
    moved = vertices.copy()
    moved[5 * 13 + 5] += [1.6, 0.0, 0.0]
    a, b, c = np.moveaxis(moved[faces][:, :, :2], 1, 0)
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    found = agreement(moved, faces, target)
    np.testing.assert_array_equal(found < 0, area < 0)
    assert np.sum(found < 0) == 2
    moved = vertices.copy()
    moved[5 * 13 + 5] = moved[6 * 13 + 5]
    found = agreement(moved, faces, target)
    assert np.sum(np.isnan(found)) == 2 and np.sum(found < 0) == 0


@pytest.mark.parametrize("uneven", [False, True])
def test_distance_is_that_of_all_triangles(uneven):
    random = np.random.default_rng(0)
    mesh = trimesh.creation.icosphere(subdivisions=2)
    vertices, faces = np.array(mesh.vertices), mesh.faces
    if uneven:  # triangles of all sizes, some of them huge
        corners = random.normal(size=(300, 1, 3)) + np.exp(
            random.uniform(-6, 2, size=(300, 1, 1))
        ) * random.normal(size=(300, 3, 3))
        vertices, faces = corners.reshape(-1, 3), np.arange(900).reshape(-1, 3)
    x = 1.5 * random.normal(size=(200, 3))
    every = np.stack(
        [
            trimesh.triangles.closest_point(
                vertices[faces], np.tile(p, (len(faces), 1))
            )
            for p in x
        ]
    )
    exact = np.linalg.norm(every - x[:, None], axis=2).min(axis=1)
    np.testing.assert_allclose(mesh_distance(x, vertices, faces), exact, rtol=1e-12)
    far = np.array([5e6, 4e5, 0.0])
    found = mesh_distance(1e3 * x + far, 1e3 * vertices + far, faces)
    np.testing.assert_allclose(found, 1e3 * exact, atol=1e-6)


@pytest.fixture(scope="module")
def registered():
    options = {"centres": 40, "progress": False}
    there = mr.register(BALL, OVAL, LANDMARKS, LANDMARKS, 1.0, **options)
    back = mr.register(OVAL, BALL, LANDMARKS, LANDMARKS, 1.0, **options)
    return there, there.report(back)


@pytest.mark.slow
def test_of_a_linear_map(registered):
    """An affine map costs nothing, so the fit is that map, and all of it is known."""
    found, report = registered
    image = BALL.vertices @ MATRIX.T
    np.testing.assert_allclose(found.vertices, image, atol=2e-3)
    # the same singular values from tangent planes of the sphere
    planes = np.linalg.svd(BALL.vertices[:, None])[2][:, 1:]
    exact = np.linalg.svd(MATRIX @ np.swapaxes(planes, 1, 2), compute_uv=False)
    np.testing.assert_allclose(report.stretches, exact, rtol=0.02)
    assert len(report.folded) == len(report.collapsed) == 0
    assert report.inverse_error.max() < 5e-3
    assert report.left_out.shape == (42,) and report.left_out.max() < 0.01
    assert report.radius95.shape == (642,) and np.all(report.radius95 > 0)
    assert report.matched is None
    corners = OVAL.triangles
    every = lambda p, t: np.linalg.norm(
        trimesh.triangles.closest_point(t, np.tile(p, (len(t), 1))) - p, axis=1
    ).min()
    one = [every(p, corners) for p in found.vertices[:50]]
    other = [every(p, found.mesh().triangles) for p in OVAL.vertices[:50]]
    np.testing.assert_allclose(report.to_target[:50], one, atol=1e-12)
    np.testing.assert_allclose(report.from_target[:50], other, atol=1e-12)
    worst = [bad for bad in report.worst(3) if bad.what == "largest stretch at vertex"]
    order = np.argsort(-report.stretches[:, 0])[:3]
    assert [bad.number for bad in worst] == order.tolist()


@pytest.mark.slow
@pytest.mark.parametrize("lam", [1e-6, 1e-4])
def test_radii_hold_the_truth(lam):
    """Also of a map through nearly all landmarks, whose residuals say nothing."""
    bent = BALL.vertices * [1.0, 1.2, 0.8] + 0.15 * np.sin(
        2 * BALL.vertices[:, [1, 2, 0]]
    )
    onto = trimesh.Trimesh(bent, BALL.faces, process=False)
    found = mr.register(
        BALL, onto, LANDMARKS, LANDMARKS, lam, centres=80, progress=False
    )
    error = np.linalg.norm(found.vertices - bent, axis=1)[42:]
    radius = found.report().radius95
    assert radius is not None
    radius = radius[42:]
    assert np.mean(error < radius) > 0.9
    assert np.median(radius) < 8 * np.median(error)


@pytest.mark.slow
def test_files(registered, tmp_path):
    _, report = registered
    told = json.loads(report.write(tmp_path / "a.json").read_text())
    assert told["vertices"] == 642 and told["folded triangles"] == 0
    assert told["largest stretch"]["most"] == report.stretches[:, 0].max()
    table = pd.read_csv(report.write(tmp_path / "a.csv"))
    assert len(table) == 642
    np.testing.assert_allclose(table["95_radius"], report.radius95)
    np.testing.assert_allclose(table[["x", "y", "z"]], report.vertices)
    with pytest.raises(ValueError, match="expected .json or .csv, found 'a.txt'"):
        report.write(tmp_path / "a.txt")
    assert re.search(r"folded triangles +0\n", str(report))


@pytest.mark.slow
def test_of_point_clouds_and_of_another_inverse(registered):
    found, report = registered
    bare = lambda surface: dataclasses.replace(surface, faces=None)
    alone = dataclasses.replace(
        found, source=bare(found.source), target=bare(found.target)
    ).report()
    assert alone.agreement is None and len(alone.folded) == 0
    np.testing.assert_allclose(alone.to_target, 0, atol=1e-9)  # on the patches
    nearest = np.linalg.norm(OVAL.vertices[:, None] - found.vertices, axis=2).min(
        axis=1
    )
    np.testing.assert_allclose(alone.from_target, nearest)
    with pytest.raises(ValueError, match="inverse: not from this target"):
        found.report(found)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:landmarks. '12' and '13' seem to be swapped")
def test_lambda_rises_until_nothing_folds():
    """Two landmarks that are exchanged: maps through them fold."""
    swapped = LANDMARKS.copy()
    swapped[[12, 13]] = swapped[[13, 12]]
    options = {"centres": 80, "progress": False}
    folded = mr.register(BALL, OVAL, LANDMARKS, swapped, 1e-5, **options)
    onto = mr.PointCloud.from_mesh(OVAL)
    count = lambda found: int(np.sum(agreement(found.vertices, BALL.faces, onto) < 0))
    assert count(folded) > 5
    whole = mr.register(BALL, OVAL, LANDMARKS, swapped, 1e-5, no_folds=True, **options)
    assert count(whole) == 0
    assert 1e-5 < float(whole.model.lam) <= 1e-5 * 4**10
    # a map without folds stays as it is
    same, left = without_folds(whole.model, lambda model: 0, lambda factor, near: near)
    assert same is whole.model and left == 0


@pytest.mark.slow
def test_says_where_folds_stay(monkeypatch):
    monkeypatch.setattr(folds, "RAISES", 1)
    turned = LANDMARKS.copy()
    turned[:12] = np.random.default_rng(0).permutation(12)
    with pytest.warns(UserWarning, match="no_folds cannot be kept: [0-9]+ triangles"):
        mr.register(
            BALL,
            OVAL,
            LANDMARKS,
            turned,
            1e-6,
            no_folds=True,
            centres=80,
            progress=False,
        )


CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")


def screenshot(page, picture):
    subprocess.run(
        [
            str(CHROMIUM), "--headless=new", "--no-sandbox", "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader", "--window-size=800,800",
            "--host-resolver-rules=MAP * ~NOTFOUND", "--virtual-time-budget=15000",
            f"--user-data-dir={picture.parent / 'profile'}",
            f"--screenshot={picture}", page.as_uri(),
        ],
        check=True, capture_output=True, timeout=120,
    )  # fmt: skip
    return imread(picture)[:, :, :3]


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_page_turns_in_a_browser(registered, tmp_path):
    """Without a network. The surface is coloured, and looks different when turned and
    under another field."""
    found, report = registered
    page = mr.plot.page(found, report, tmp_path / "page.html", "ball <-> oval")
    text = page.read_text()
    assert "<h1>ball &lt;-&gt; oval</h1>" in text and 'src="http' not in text
    shots = [screenshot(page, tmp_path / "first.png")]
    for change in (
        "Plotly.relayout('surface', {'scene.camera.eye': {x: -1.5, y: 0.9, z: -0.4}})",
        "Plotly.update('surface', surface.layout.updatemenus[0].buttons[3].args[0])",
    ):
        script = f"<script>window.onload = () => {change}</script></body>"
        changed = tmp_path / "changed.html"
        changed.write_text(text.replace("</body>", script))
        shots.append(screenshot(changed, tmp_path / f"changed{len(shots)}.png"))
    for shot in shots:
        middle = shot[200:600, 100:650]
        coloured = np.ptp(middle, axis=2) > 0.1
        assert np.mean(coloured) > 0.05
        assert len(np.unique((middle[coloured] * 20).astype(int), axis=0)) > 20
    assert np.mean(np.abs(shots[1] - shots[0]).max(axis=2) > 0.05) > 0.02
    assert np.mean(np.abs(shots[2] - shots[0]).max(axis=2) > 0.05) > 0.02


@pytest.mark.slow
def test_pictures(registered, tmp_path):
    found, report = registered
    some = np.where(np.arange(len(BALL.faces)) < 30, -1.0, 1.0)
    folded = dataclasses.replace(report, agreement=some)
    for name, told in (("whole", report), ("folded", folded)):
        mr.plot.save(mr.plot.certificate(found, told), tmp_path / f"{name}.png")
    whole, red = (imread(tmp_path / f"{name}.png") for name in ("whole", "folded"))
    is_red = lambda p: np.sum(
        (p[:, :, 0] > 0.9) & (p[:, :, 1] < 0.1) & (p[:, :, 2] < 0.1)
    )
    assert is_red(red) > is_red(whole) + 50
    page = mr.plot.page(found, folded, tmp_path / "page.html")
    assert '"color":"red"' in page.read_text()
    with pytest.raises(ValueError, match="expected a file .html, found 'page.htm.pdf'"):
        mr.plot.page(found, report, tmp_path / "page.htm.pdf")


@pytest.mark.slow
def test_command(tmp_path):
    BALL.export(tmp_path / "ball.ply")
    OVAL.export(tmp_path / "oval.ply")
    pairs = tmp_path / "pairs.csv"
    np.savetxt(
        pairs,
        np.stack([LANDMARKS] * 2, 1),
        "%d",
        ",",
        header="source,target",
        comments="",
    )
    arguments = [
        "register", tmp_path / "ball.ply", tmp_path / "oval.ply", "--landmarks", pairs,
        "--out", tmp_path / "out.ply", "--lam", 1, "--centres", 40, "--no-folds",
        "--inverse",
    ]  # fmt: skip
    run = lambda *more: CliRunner().invoke(app, [str(a) for a in (*arguments, *more)])
    told = run("--report", tmp_path / "a.json", "--page", tmp_path / "a.html")
    assert told.exit_code == 0, told.output
    assert "folded triangles" in told.output and "a.html" in told.output
    assert json.loads((tmp_path / "a.json").read_text())["inverse error"]["most"] < 0.01
    assert "Plotly.newPlot" in (tmp_path / "a.html").read_text()
    assert (
        "--report: expected .json or .csv" in run("--report", tmp_path / "a.xls").output
    )
    assert "--inverse: is told in a report" in run().output
