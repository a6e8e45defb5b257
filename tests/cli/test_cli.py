"""The command line from end to end: real fits, small."""

import re
import subprocess
import sys
import warnings

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.image import imread
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from manireg import datasets
from manireg._cli.app import app
from manireg._cli.demo import running_mean
from manireg._cli.errors import clean_errors
from manireg.datasets import read_table

T = np.linspace(0, 2, 12)


def run(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def table(path, **columns):
    rows = np.stack(list(columns.values()), axis=-1)
    header = ",".join(columns)
    np.savetxt(path, rows, "%.12g", delimiter=",", header=header, comments="")
    return path


def columns_of(path, *names):
    found = read_table(path)
    return np.stack([found[name] for name in names], axis=-1)


def great_circle(t):
    return np.stack([np.cos(t), 0.6 * np.sin(t), 0.8 * np.sin(t)], axis=-1)


@pytest.fixture
def sphere_csv(tmp_path):
    x, y, z = great_circle(T).T
    return table(tmp_path / "data.csv", age=T, x=x, y=y, z=z, w=1 + T)


@pytest.fixture
def fit(tmp_path):
    """Runs `manireg fit` with a fixed lambda and returns what it wrote and printed."""

    def fit(file, *arguments):
        out = tmp_path / "predictions.csv"
        result = run("fit", file, "--out", out, *arguments)
        assert result.exit_code == 0, result.output
        return out, result.output

    return fit


def test_demo(tmp_path):
    out = tmp_path / "demo.png"
    result = run("demo", "--plate", "East_Antarctica", "--out", out)
    assert result.exit_code == 0, result.output
    printed = " ".join(result.output.split())
    assert "18 poles of east_antarctica, 1 to 515 million years" in printed
    assert "(restricted likelihood)" in printed and "reduced chi^2" in printed
    ((low, high),) = re.findall(r"poles\) ([\d.]+) to ([\d.]+) degrees", printed)
    assert 1 < float(low) < float(high) < 90
    assert imread(out).shape[1] > 800


def test_running_mean():
    """Four poles about a common one, then two, which are too few."""
    angle = np.radians([[80, 0], [80, 180], [80, 90], [80, 270], [0, 0], [0, 0]])
    lat, lon = angle.T
    points = np.stack(
        [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    )
    ages = np.array([1.0, 2.0, 28.0, 29.0, 95.0, 96.0])
    poles = datasets.PalaeomagneticPoles(ages, points.T, np.ones(6), np.full(6, "a"))
    (piece,) = running_mean(poles, window=60.0)
    np.testing.assert_allclose(piece, [[0, 0, 1]] * len(piece), atol=1e-15)
    assert len(piece) == 3  # at 10, 20 and 30 Ma


@pytest.mark.parametrize(
    "order, words",
    [
        ("3", "energy of order 3"),
        ("x", "--order is"),
        ("7", "order: expected 1, 2, 3 or 4"),
    ],
)
def test_order(sphere_csv, tmp_path, order, words):
    asked = "fit", sphere_csv, "--target", "sphere", "--input", "age"
    wanted = "--output", "x,y,z", "--out", tmp_path / "out.csv", "--lam", 0.1
    result = run(*asked, *wanted, "--order", order)
    assert (result.exit_code == 0) == (order == "3")
    assert words in " ".join(result.output.split())


def test_sphere_geodesic_is_reproduced(fit, sphere_csv, tmp_path):
    """A great circle has no Eells energy, so any lambda gives it back."""
    picture = tmp_path / "fit.pdf"
    arguments = ["--target", "sphere", "--input", "age", "--output", "x,y,z"]
    out, printed = fit(
        sphere_csv, *arguments, "--weights", "w", "--lam", 1, "--picture", picture
    )
    assert "12 rows of data.csv, age -> sphere" in printed
    written = columns_of(out, "age", "x", "y", "z")
    np.testing.assert_allclose(written[:, 0], np.linspace(0, 2, 200))
    np.testing.assert_allclose(written[:, 1:], great_circle(written[:, 0]), atol=1e-5)
    assert picture.read_bytes().startswith(b"%PDF")


def test_lat_lon_and_input_file(fit, tmp_path):
    x, y, z = great_circle(T).T
    lat, lon = np.degrees(np.arcsin(z)), np.degrees(np.arctan2(y, x))
    file = table(tmp_path / "data.csv", age=T, lat=lat, lon=lon)
    wanted = table(tmp_path / "ages.csv", other=[1.0, 2.0], age=[0.33, 1.77])
    arguments = ["--target", "sphere", "--input", "age", "--lat-lon", "lat,lon"]
    out, _ = fit(file, *arguments, "--lam", 1, "--predict", wanted)
    found = np.radians(columns_of(out, "lat", "lon"))
    expected = great_circle(np.array([0.33, 1.77]))
    np.testing.assert_allclose(np.sin(found[:, 0]), expected[:, 2], atol=1e-5)
    np.testing.assert_allclose(
        np.tan(found[:, 1]), expected[:, 1] / expected[:, 0], atol=1e-4
    )


@pytest.mark.parametrize("form", ["quaternion", "matrix"])
@pytest.mark.slow
def test_rotations(fit, tmp_path, form):
    turns = Rotation.from_rotvec(np.outer(T, [1.0, 2.0, -1.0]))
    if form == "quaternion":
        values = turns.as_quat(scalar_first=True)
        values[::2] *= -1
        names = ["w", "x", "y", "z"]
    else:
        values = turns.as_matrix().reshape(-1, 9)
        names = [f"r{i}{j}" for i in range(3) for j in range(3)]
    columns = dict(zip(names, values.T, strict=True))
    file = table(tmp_path / "data.csv", time=T, **columns)
    out, _ = fit(
        file, "--target", "rotations", "--input", "time", "--output", ",".join(names),
        "--lam", 1, "--picture", tmp_path / "fit.png",
    )  # fmt: skip
    found = columns_of(out, "time", *names)
    expected = Rotation.from_rotvec(np.outer(found[:, 0], [1.0, 2.0, -1.0]))
    if form == "quaternion":
        assert np.all((found[1:, 1:] * found[:-1, 1:]).sum(-1) > 0.9)
        rotations = Rotation.from_quat(found[:, 1:], scalar_first=True)
    else:
        rotations = Rotation.from_matrix(found[:, 1:].reshape(-1, 3, 3))
    assert (rotations.inv() * expected).magnitude().max() < 1e-5


@pytest.mark.slow
def test_circle_across_the_cut(fit, tmp_path):
    file = table(tmp_path / "data.csv", hour=T, wind=(300 + 90 * T) % 360)
    arguments = ["--target", "circle", "--input", "hour", "--output", "wind"]
    out, _ = fit(file, *arguments, "--lam", 1, "--picture", tmp_path / "fit.svg")
    hour, wind = columns_of(out, "hour", "wind").T
    assert wind.min() >= 0 and wind.max() < 360
    error = (wind - 300 - 90 * hour + 180) % 360 - 180
    assert np.abs(error).max() < 1e-3
    assert "wind" in (tmp_path / "fit.svg").read_text()


@pytest.mark.slow
def test_euclidean_plane_from_a_box(fit, tmp_path):
    rng = np.random.default_rng(0)
    u, v = rng.uniform([[-1], [2]], [[1], [5]], (2, 60))
    file = table(tmp_path / "data.csv", u=u, v=v, a=1 + 2 * u - v, b=u + 3 * v)
    out, _ = fit(
        file, "--target", "euclidean", "--input", "u,v", "--output", "a,b",
        "--lam", 0.1, "--predict", 100, "--picture", tmp_path / "fit.png",
    )  # fmt: skip
    u, v, a, b = columns_of(out, "u", "v", "a", "b").T
    assert len(u) == 100
    np.testing.assert_allclose(a, 1 + 2 * u - v, atol=1e-5)
    np.testing.assert_allclose(b, u + 3 * v, atol=1e-5)


@pytest.mark.slow
def test_automatic_lambda(fit, tmp_path):
    """Noise about a geodesic: cross-validation must smooth a good part of it away."""
    rng = np.random.default_rng(1)
    t = np.linspace(0, 2, 24)
    noisy = great_circle(t) + 0.05 * rng.normal(size=(24, 3))
    noisy /= np.linalg.norm(noisy, axis=-1, keepdims=True)
    x, y, z = noisy.T
    file = table(tmp_path / "data.csv", age=t, x=x, y=y, z=z)
    arguments = ["--target", "sphere", "--input", "age", "--output", "x,y,z"]
    out, printed = fit(file, *arguments, "--folds", 4)
    assert "(cross-validation)" in printed and "held-out error, mean" in printed
    age, *_ = columns_of(out, "age").T
    error = np.linalg.norm(columns_of(out, "x", "y", "z") - great_circle(age), axis=-1)
    assert np.sqrt(np.mean(error**2)) < 0.03


OUTPUT = ["--output", "x,y,z"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([*OUTPUT, "--input", "ages"], "no column `ages` for --input. It has: age, x"),
        ([*OUTPUT, "--input", "x"], "--input, --output: column `x` is named twice."),
        (["--output", "x,y,q"], "no column `q` for --output. It has: age, x, y, z, w,"),
        ([*OUTPUT, "--weights", "name"], "column `name` has text, 'a'; --weights"),
        ([*OUTPUT, "--weights", "gap", "--missing", "error"],
         "column `gap` is empty or not finite in 1 of"),
        ([*OUTPUT, "--weights", "bad"], "column `bad` has -1 in data row 2. Remove"),
        (["--output", "x,y,bad"], "not unit vectors; for latitude and longitude use"),
        (["--output", "x,y", "--lat-lon", "x,y"], "Give either --output or --lat-lon"),
        ([], "Give either --output or --lat-lon"),
        (["--lat-lon", "x"], "--lat-lon takes two columns, found 1"),
        (["--lat-lon", "far,x"], "latitude `far` leaves [-90, 90] degrees. Give"),
        ([*OUTPUT, "--input", "same"], "input column `same` is constant, 4"),
        ([*OUTPUT, "--lam", "small"], "--lam is a number or auto, found 'small'"),
        ([*OUTPUT, "--lam", "-1"], "lam"),
        ([*OUTPUT, "--predict", "no.csv"], "no.csv: no such file."),
        ([*OUTPUT, "--picture", "a.bmp"], "a.bmp: a picture ends in .png, .pdf or"),
        ([*OUTPUT, "--picture", "no/a.png"], "there is no folder no"),
        ([*OUTPUT, "--out", "no/p.csv"], "there is no folder no"),
        (["--target", "circle", "--lat-lon", "x,y"], "--lat-lon is for --target sph"),
        (["--target", "circle", *OUTPUT], "--target circle takes one column, an angle"),
        (["--target", "rotations", *OUTPUT], "(quaternion w,x,y,z) or nine (matrix,"),
        (["--target", "sphere", "--output", "x"], "two columns or more"),
    ],
)  # fmt: skip
def test_mistakes(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data.csv").write_text(
        "age,x,y,z,w,name,gap,bad,far,same\n"
        "0,1,0,0,1,a,1,1,100,4\n"
        "1,0,1,0,1,b,,-1,0,4\n"
        "2,0,0,1,1,c,1,7,0,4\n"
    )
    result = run("fit", "data.csv", "--target", "sphere", "--input", "age", *arguments)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.startswith("manireg: ") and result.stderr.count("\n") == 1


FIT = "manireg._cli.fit.chosen_fit"
STOPPED = """fit: Newton stopped after 60 steps at a gradient of 0.1.

Take a larger `lam`."""


def stop(x):
    return eqx.error_if(x, x == 0, STOPPED)


def raises(error):
    def fail(*_, **__):
        raise error

    return fail


@pytest.mark.parametrize(
    ("fail", "said"),
    [
        (lambda *_, **__: stop(jnp.zeros(())), " ".join(STOPPED.split())),
        (lambda *_, **__: eqx.filter_jit(stop)(jnp.zeros(())), " ".join(STOPPED.split())),
        (raises(RuntimeError(STOPPED)), " ".join(STOPPED.split())),
        (
            raises(RuntimeError("INTERNAL: lost")),
            "the computation failed: INTERNAL: lost",
        ),
        (
            raises(RuntimeError("RESOURCE_EXHAUSTED: allocating 800 bytes.")),
            "out of memory (800 bytes were asked for). Use fewer rows, predictions or "
            "--centres, or a machine with more memory.",
        ),
        (
            raises(MemoryError("Unable to allocate 74.5 GiB for an array")),
            "out of memory (74.5 GiB were asked for). Use fewer rows, predictions or "
            "--centres, or a machine with more memory.",
        ),
        (
            raises(MemoryError()),
            "out of memory. Use fewer rows, predictions or --centres, or a machine with "
            "more memory.",
        ),
        (raises(ModuleNotFoundError("No module named 'networkx'", name="networkx")),
         "No module named 'networkx'. Install it: pip install networkx."),
        (raises(PermissionError(13, "Permission denied", "a.csv")),
         "[Errno 13] Permission denied: 'a.csv'"),
    ],
)  # fmt: skip
def test_failed_fit(sphere_csv, monkeypatch, fail, said):
    monkeypatch.setattr(FIT, fail)
    result = run(
        "fit", sphere_csv, "--target", "sphere", "--input", "age", *OUTPUT, "--lam", 1
    )
    assert result.exit_code == 2
    assert result.stderr.splitlines()[-1] == f"manireg: {said}"


def test_interrupt(sphere_csv, monkeypatch):
    monkeypatch.setattr(FIT, raises(KeyboardInterrupt()))
    result = run(
        "fit", sphere_csv, "--target", "sphere", "--input", "age", *OUTPUT, "--lam", 1
    )
    assert result.exit_code == 130
    assert result.stderr.splitlines()[-1] == "manireg: interrupted."


def test_warnings_are_notes(capsys):
    with clean_errors():
        for _ in range(2):
            warnings.warn("the basis limits\nthe fit.", stacklevel=1)
    assert capsys.readouterr().err == "manireg: note: the basis limits the fit.\n"


def test_files_that_cannot_be_written(sphere_csv, tmp_path):
    arguments = ["--target", "sphere", "--input", "age", *OUTPUT, "--out", tmp_path]
    result = run("fit", sphere_csv, *arguments)
    assert result.exit_code == 2 and "is a folder; name a file." in result.stderr


def test_missing_file_and_plate(tmp_path):
    result = run("fit", tmp_path / "no.csv", "--target", "sphere", "--input", "age")
    assert result.exit_code == 2 and "no.csv: no such file." in result.stderr
    result = run("demo", "--plate", "atlantis")
    assert result.exit_code == 2
    assert (
        "No plate 'atlantis' with 15 poles; there are: gondwana, amazonia"
        in result.stderr
    )


def test_help_shows_examples():
    commands = run("--help").output
    assert "fit" in commands and "demo" in commands
    assert "manireg fit poles.csv --target sphere" in run("fit", "--help").output
    assert "north_america" in run("demo", "--help").output


@pytest.mark.slow
def test_module_switches_x64_on(sphere_csv, tmp_path):
    """`python -m manireg` in a process of its own, where x64 starts off."""
    out = tmp_path / "out.csv"
    run = subprocess.run(
        [sys.executable, "-m", "manireg", "fit", sphere_csv, "--target", "sphere",
         "--input", "age", "--output", "x,y,z", "--lam", "1", "--out", out],
        capture_output=True, text=True,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    lengths = np.linalg.norm(columns_of(out, "x", "y", "z"), axis=-1)
    np.testing.assert_allclose(lengths, 1, atol=1e-9)
