"""One template onto a folder of scans."""

import os
from typing import Any

import numpy as np
import pandas
import pytest
import trimesh
from broken_meshes import F, W
from typer.testing import CliRunner

import manireg as mr
from manireg._cli.app import app
from manireg._surfaces import batch as _batch
from manireg._surfaces.batch_files import scans_in, shard_of, whole
from manireg.meshes import read_mesh, write_mesh

NUMBERS = np.arange(0, 162, 8)
OPTIONS: dict[str, Any] = {"centres": 20, "tell": lambda line: None}


def bent(k: int) -> np.ndarray:
    return W * [1.0, 1.0 + 0.05 * k, 1.0] + 0.03 * k * np.sin(2 * W[:, [1, 2, 0]])


def landmarks(vertices) -> str:
    rows = [f"p{i},{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate(vertices.tolist())]
    return "\n".join(["name,x,y,z", *rows])


@pytest.fixture
def folders(tmp_path):
    """A template, four scans, and two that fail: without landmarks, and without a mesh in
    the file."""
    scans, marks = tmp_path / "scans", tmp_path / "marks"
    for folder in (scans, marks):
        folder.mkdir()
    write_mesh(trimesh.Trimesh(W, F, process=False), scans / "mean.obj")
    (marks / "mean.csv").write_text(landmarks(W[NUMBERS]))
    for k in range(1, 5):
        mesh = trimesh.Trimesh(bent(k), F, process=False)
        write_mesh(mesh, scans / f"scan{k}.obj")
        (marks / f"scan{k}.csv").write_text(landmarks(bent(k)[NUMBERS]))
    write_mesh(trimesh.Trimesh(W, F, process=False), scans / "unmarked.ply")
    (scans / "broken.ply").write_text("ply\nnothing\n")
    (marks / "broken.csv").write_text(landmarks(W[NUMBERS]))
    return scans / "mean.obj", scans, marks, tmp_path / "out"


def only_bad(folders):
    template, scans, marks, _ = folders
    for k in range(1, 5):
        (scans / f"scan{k}.obj").unlink()
    return template, scans, marks


def test_scans_that_fail(folders):
    said, out = [], folders[3]
    found = mr.register_folder(*only_bad(folders), out, tell=said.append)
    assert found.done == () and set(found.failed) == {"broken", "unmarked"}
    assert "no landmarks called 'unmarked'" in found.failed["unmarked"]
    assert "cannot load" in found.failed["broken"]
    assert said[0].startswith("1 of 2: broken: failed. ")
    table = pandas.read_csv(out / "quality.csv")
    assert list(table.scan) == ["broken", "unmarked"] and table.error.notna().all()


def test_command_of_scans_that_fail(folders):
    template, scans, marks = only_bad(folders)
    arguments = ["register", template, scans, "--landmarks", marks, "--out", folders[3]]
    run = CliRunner().invoke(app, [str(a) for a in arguments])
    assert run.exit_code == 1 and "passed over  broken, unmarked" in run.output
    run = CliRunner().invoke(app, [*map(str, arguments), "--shard", "3 of 4"])
    assert run.exit_code == 2 and "expected for instance 3/16" in run.output
    run = CliRunner().invoke(app, [*map(str, arguments), "--morph", "0.5"])
    assert run.exit_code == 2 and "only for a single target" in run.output
    run = CliRunner().invoke(app, [*map(str, arguments), "--shard", "5/4"])
    assert run.exit_code == 2 and "1 <= k <= n, found 5 of 4" in run.output


def test_what_belongs_together(folders):
    template, scans, marks, _ = folders
    found = scans_in(scans, marks, template)
    names = ["broken", "scan1", "scan2", "scan3", "scan4", "unmarked"]
    assert [scan.name for scan in found] == names
    parts = [shard_of(found, (k, 4)) for k in range(1, 5)]
    assert sorted(scan.name for part in parts for scan in part) == names
    write_mesh(trimesh.Trimesh(W, F, process=False), scans / "scan1.ply")
    with pytest.raises(ValueError, match="two meshes are called 'scan1'"):
        scans_in(scans, marks, template)
    with pytest.raises(ValueError, match="holds no meshes"):
        scans_in(marks, marks, None)


def test_never_half_a_file(tmp_path):
    (tmp_path / "a").write_text("before")
    with pytest.raises(InterruptedError), whole(tmp_path / "a") as path:
        path.write_text("half")
        raise InterruptedError
    assert (tmp_path / "a").read_text() == "before"
    assert os.listdir(tmp_path) == ["a"]


@pytest.mark.slow
def test_folder(folders, tmp_path, monkeypatch):
    """Killed after the second scan, then resumed by shards; the same as one by one."""
    template, scans, marks, out = folders
    points = marks.parent / "points.fcsv"
    rows = [
        f"{i},{x!r},{y!r},{z!r},,,,,,,,q{i},,"
        for i, (x, y, z) in enumerate(W[5:8].tolist())
    ]
    points.write_text("\n".join(["# CoordinateSystem = RAS", *rows]))
    options: Any = {**OPTIONS, "transfer": points}

    def killed(line):
        if "scan2" in line:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mr.register_folder(
            template, scans, marks, out, 1e-4, **options | {"tell": killed}
        )
    first = out / "scans" / "scan1.npz"
    before = first.stat().st_mtime_ns
    assert not (out / "vertices.npz").exists()
    one = mr.register_folder(template, scans, marks, out, 1e-4, shard=(1, 2), **options)
    assert one.done == ("scan1", "scan2", "scan4")
    assert one.waiting == ("scan3", "unmarked") and set(one.failed) == {"broken"}
    found = mr.register_folder(
        template, scans, marks, out, 1e-4, shard=(2, 2), **options
    )
    assert found.done == ("scan1", "scan2", "scan3", "scan4") and found.waiting == ()
    assert first.stat().st_mtime_ns == before
    with np.load(out / "vertices.npz") as kept:
        vertices = kept["vertices"]
        assert list(kept["names"]) == list(found.done)
    assert vertices.shape == (4, *W.shape)
    for k, vertex in enumerate(vertices, 1):
        mesh = read_mesh(scans / f"scan{k}.obj")
        alone = mr.register(
            template, mesh, marks / "mean.csv", marks / f"scan{k}.csv", 1e-4,
            centres=20, progress=False,
        )  # fmt: skip
        np.testing.assert_allclose(vertex, alone.vertices, atol=1e-9)
        written = read_mesh(out / "meshes" / f"scan{k}.ply")
        np.testing.assert_allclose(written.vertices, vertex, atol=1e-6)
        np.testing.assert_array_equal(written.faces, F)
        carried = mr.read_landmarks(out / "points" / f"scan{k}.fcsv")
        assert carried.names == ("q0", "q1", "q2") and carried.system == "RAS"
        assert carried.positions is not None
        np.testing.assert_allclose(carried.positions, vertex[5:8], atol=1e-3)
    table = pandas.read_csv(out / "quality.csv").set_index("scan")
    assert (table.landmarks[list(found.done)] == len(NUMBERS)).all()
    assert set(table.index[table.error.notna()]) == {"broken", "unmarked"}
    with np.load(out / "shapes.npz") as shapes:
        assert shapes["variances"][0] > 3 * shapes["variances"][1]
    # what changed is done again
    monkeypatch.setattr(_batch, "VERSION", _batch.VERSION + 1)
    again = mr.register_folder(
        template, scans, marks, out, 1e-4, shard=(2, 2), **options
    )
    assert again.done == ("scan1", "scan3") and again.waiting == ("scan2", "scan4")
