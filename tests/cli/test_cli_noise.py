"""Noise at the command line: what columns and options become, and what comes out."""

import types

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from typer.testing import CliRunner

import manireg as mr
from manireg._cli.app import app
from manireg._cli.tables import Target, TargetName
from manireg._cli.uncertainty import uncertainty
from manireg.datasets import read_table

HEADER = "age,low,high,lat,lon,s,k,bad,gap,w,x,y,z"
ROWS = [
    "0,-1,2,10,20,2,100,1,1,1,0,0,0",
    "1,0,3,11,21,4,25,0,2,1,0,0,0",
    "3,2,2,12,23,1,400,2,,1,0,0,0",
    "4,3,8,13,24,2,100,3,4,1,0,0,0",
]
GLOBE = ["--target", "sphere", "--lat-lon", "lat,lon"]
LINE = ["--target", "euclidean", "--output", "lat"]
TURN = ["--target", "rotations", "--output", "w,x,y,z"]
ANGLE = ["--target", "circle", "--output", "lon"]
AGE = ["--input", "age"]
BOTH = ["--input", "age,lat"]


@pytest.fixture
def table(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data.csv").write_text("\n".join([HEADER, *ROWS]))


def run(*arguments):
    return CliRunner().invoke(app, ["fit", "data.csv", *map(str, arguments)])


@pytest.fixture
def asked(table, monkeypatch):
    """What `manireg fit` asks for: source, inputs, arguments and options."""
    reached = {}

    def stop(source, target, x, y, lam, data, scatter, **choice):
        reached.update(
            source=source, x=x, lam=lam, data=data, scatter=scatter, **choice
        )
        raise ValueError("stopped")

    monkeypatch.setattr("manireg._cli.fit.chosen_fit", stop)

    def asked(*arguments):
        result = run(*arguments)
        assert "stopped" in result.stderr, result.output + repr(result.exception)
        return reached

    return asked


S = np.array([2.0, 4.0, 1.0, 2.0])
SIGMAS = {
    "directions": ([*GLOBE, "--sigma", "s"], np.radians(S)),
    "angles": ([*ANGLE, "--sigma", "S"], np.radians(S)),
    # of a turn by an angle, entries of the matrix move by sqrt 2 times as much
    "rotations": ([*TURN, "--sigma", "s"], np.sqrt(2) * np.radians(S)),
    "numbers": ([*LINE, "--sigma", "s"], S),
    "radii": ([*GLOBE, "--a95", "s"], np.radians(S) / np.sqrt(chi2.ppf(0.95, 2))),
    "concentrations": ([*GLOBE, "--kappa", "k"], np.array([0.1, 0.2, 0.05, 0.1])),
}


@pytest.mark.parametrize("form", SIGMAS)
def test_standard_deviations(asked, form):
    arguments, expected = SIGMAS[form]
    found = asked(*AGE, *arguments)
    np.testing.assert_allclose(found["data"]["sigma"], expected, rtol=1e-12)
    assert found["scatter"] == "additive" and found["criterion"] == "error"


def test_without_options_nothing_is_passed(asked):
    found = asked(*AGE, *GLOBE)
    assert isinstance(found["data"].pop("loss"), mr.Squared)
    assert found["data"] == {"weights": None, "order": 2}
    assert found["lam"] is None


@pytest.mark.parametrize(
    ("name", "loss"),
    [("huber", mr.Huber), ("tukey", mr.Tukey), ("student", mr.StudentT)],
)
def test_losses_and_choices(asked, name, loss):
    choice = ["--scatter", "factor", "--criterion", "reml"]
    found = asked(*AGE, *GLOBE, "--sigma", "s", "--loss", name, *choice)
    assert isinstance(found["data"]["loss"], loss)
    assert found["scatter"] == "factor" and found["criterion"] == "reml"


def test_uncertain_inputs(asked):
    found = asked(*AGE, *GLOBE, "--x-sigma", "s")
    np.testing.assert_array_equal(found.pop("x_sigma"), S)
    assert "x_min" not in found and "sigma" not in found["data"]
    found = asked(*AGE, *GLOBE, "--x-min", "low", "--x-max", "high")
    np.testing.assert_array_equal(found["x_min"], [-1, 0, 2, 3])
    np.testing.assert_array_equal(found["x_max"], [2, 3, 2, 8])
    np.testing.assert_array_equal(found["x"], [0, 1, 3, 4])
    # wherever inputs may be, the map is defined
    assert (found["source"].a, found["source"].b) == (-1, 8)
    found = asked(*GLOBE, "--x-min", "low", "--x-max", "high")
    np.testing.assert_array_equal(found["x"], [0.5, 1.5, 2, 5.5])


@pytest.mark.parametrize("given", ["age", None])
def test_uncertain_dates(asked, tmp_path, given):
    days = ["from,to,age,y"] + [
        f"2024-05-0{d},2024-05-0{d + 2},2024-05-0{d},{d}" for d in (1, 2, 4)
    ]
    (tmp_path / "data.csv").write_text("\n".join(days))
    arguments = [] if given is None else ["--input", given]
    line = ["--target", "euclidean", "--output", "y"]
    found = asked(*arguments, *line, "--x-min", "from", "--x-max", "to")
    width = found["x_max"] - found["x_min"]
    np.testing.assert_array_equal(width, 2 * 86400.0)
    middle = found["x"] - found["x_min"]
    np.testing.assert_array_equal(middle, 86400.0 * (given is None))


def test_missing_values_of_noise(asked):
    found = asked(*AGE, *GLOBE, "--a95", "gap")
    assert len(found["data"]["sigma"]) == 3
    result = run(*AGE, *GLOBE, "--a95", "gap", "--missing", "error")
    assert "column `gap` is empty or not finite in 1 of 4" in result.stderr


MISTAKES = [
    ([*AGE, *GLOBE, "--sigma", "s", "--a95", "s"], "precise rows are; give one of them"),
    ([*AGE, *GLOBE, "--a95", "bad"],
     "confidence radii must be positive, but column `bad` has 0 in data row 2. Remove the "
     "row (line 3)."),
    ([*AGE, *LINE, "--kappa", "k"], "--kappa is of directions on the sphere; for other"),
    ([*AGE, *ANGLE, "--a95", "s"], "--a95 is of directions on the sphere"),
    ([*AGE, *GLOBE, "--sigma", "q"], "no column `q` for --sigma. It has"),
    ([*AGE, *GLOBE, "--x-min", "low"], "--x-min, --x-max: give both ends"),
    ([*AGE, *GLOBE, "--x-min", "high", "--x-max", "low"],
     "high must not exceed low, but column `high` has 2 in data row 1."),
    ([*AGE, *GLOBE, "--x-sigma", "s", "--x-min", "low", "--x-max", "high"],
     "a standard deviation or a range; give one"),
    ([*BOTH, *ANGLE, "--x-sigma", "s"], "for one input, found 2."),
    ([*AGE, *GLOBE, "--x-sigma", "bad"], "of the input must be positive, but column"),
    ([*GLOBE], "Give --input, the input column, or --x-min and --x-max."),
    ([*AGE, *GLOBE, "--level", "0"], "--level is a percentage between 0 and 100"),
    ([*AGE, *GLOBE, "--loss", "huber", "--folds", 3], "folds: each would have robust"),
    ([*AGE, *GLOBE, "--criterion", "reml", "--folds", 3], "folds: they have an error"),
]  # fmt: skip


@pytest.mark.parametrize(("arguments", "message"), MISTAKES)
def test_mistakes(table, arguments, message):
    result = run(*arguments)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.startswith("manireg: ") and result.stderr.count("\n") == 1


def written(tmp_path, columns, *arguments):
    """Columns of the predictions, and what was printed."""
    np.savetxt(
        tmp_path / "data.csv",
        np.stack(list(columns.values()), axis=-1),
        "%.15g",
        delimiter=",",
        header=",".join(columns),
        comments="",
    )
    result = run("--input", "t", "--out", "out.csv", *arguments)
    assert result.exit_code == 0, result.output + repr(result.exception)
    return read_table(tmp_path / "out.csv"), " ".join(result.output.split())


T = np.linspace(0, 1, 15)
RNG = np.random.default_rng(0)
GIVEN = RNG.uniform(0.5, 2.0, 15)
STIFF = ["--lam", 1e3, "--scatter", "none"]


def line_error(t, sigma):
    """Standard error of a straight line, by weighted least squares."""
    design = np.stack([np.ones_like(T), T], axis=-1)
    inverse = np.linalg.inv(design.T @ (design / sigma[:, None] ** 2))
    at = np.stack([np.ones_like(t), t], axis=-1)
    return np.sqrt(np.einsum("ia,ab,ib->i", at, inverse, at))


def test_a_line(tmp_path, monkeypatch):
    """At a large lambda, linear regression with known variances; the added columns, chi^2
    and the degrees of freedom as in a textbook."""
    monkeypatch.chdir(tmp_path)
    y = 1 + 2 * T + GIVEN * RNG.normal(size=15)
    data = {"t": T, "y": y, "s": GIVEN}
    line = ["--target", "euclidean", "--output", "y"]
    found, printed = written(
        tmp_path, data, *line, "--sigma", "s", *STIFF, "--picture", "fit.png"
    )
    expected = line_error(found["t"], GIVEN)
    np.testing.assert_allclose(found["se_y"], expected, rtol=1e-3)
    slope = np.polynomial.Polynomial.fit(T, y, 1, w=1 / GIVEN)
    chi = np.sum(((y - slope(T)) / GIVEN) ** 2) / 13
    assert f"phi (reduced chi^2) {chi:.3g}" in printed
    assert "degrees of freedom 2.0 of 15" in printed


def near_equator(sigma):
    """Constant speed along a short arc, the noise the same along and across."""
    noise = np.radians(sigma)[:, None] * RNG.normal(size=(15, 2))
    lat, lon = noise[:, 0], 0.05 * (T - 0.5) + noise[:, 1]
    return {"t": T, "lat": np.degrees(lat), "lon": np.degrees(lon)}


def test_a_path_on_the_sphere(tmp_path, monkeypatch):
    """On an arc of 3 degrees the sphere is nearly flat: both coordinates are lines."""
    monkeypatch.chdir(tmp_path)
    sigma = 0.1 * GIVEN
    data = near_equator(sigma) | {"a95": np.sqrt(chi2.ppf(0.95, 2)) * sigma}
    globe = ["--target", "sphere", "--lat-lon", "lat,lon", "--a95", "a95"]
    found, printed = written(tmp_path, data, *globe, *STIFF, "--level", 68)
    radius = np.sqrt(chi2.ppf(0.68, 2)) * line_error(found["t"], sigma)
    np.testing.assert_allclose(found["theta68"], radius, rtol=2e-3)
    round_ = np.sqrt(found["semi_major"] * found["semi_minor"])
    np.testing.assert_allclose(round_, found["theta68"], rtol=1e-12)
    assert np.all(found["semi_major"] >= found["semi_minor"])
    assert np.all((found["azimuth"] >= 0) & (found["azimuth"] < 180))
    np.testing.assert_allclose(found["speed"], np.degrees(0.05), rtol=0.1)
    slope = sigma[:, None] ** -2 * np.stack([np.ones(15), T], axis=-1)
    inverse = np.linalg.inv(np.stack([np.ones(15), T]) @ slope)
    np.testing.assert_allclose(found["se_speed"], inverse[1, 1] ** 0.5, rtol=5e-3)
    assert "theta68 (path, not poles)" in printed


@pytest.mark.slow
def test_ranges_of_inputs(tmp_path, monkeypatch):
    """Exact outputs of a line, at inputs that are known to a tenth: the line."""
    monkeypatch.chdir(tmp_path)
    shift = RNG.uniform(-0.05, 0.05, 15)
    data = {"t": T + shift, "low": T + shift - 0.05, "high": T + shift + 0.05}
    data |= {"y": 1 + 2 * T, "s": np.full(15, 0.01)}
    line = ["--target", "euclidean", "--output", "y", "--sigma", "s", *STIFF]
    found, _ = written(tmp_path, data, *line, "--x-min", "low", "--x-max", "high")
    inside = (found["t"] > 0.1) & (found["t"] < 0.9)
    np.testing.assert_allclose(
        found["y"][inside], 1 + 2 * found["t"][inside], atol=0.05
    )


def test_outliers_are_counted(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data = near_equator(np.full(15, 0.05))
    data["lat"][[3, 9]] += 5.0
    globe = ["--target", "sphere", "--lat-lon", "lat,lon"]
    _, printed = written(tmp_path, data, *globe, "--loss", "tukey", "--lam", 1)
    assert "weights left 2 below a half" in printed


@pytest.mark.slow
def test_angles(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sigma = 0.1 * GIVEN
    data = {
        "t": T,
        "wind": (359 + 2 * T + sigma * RNG.normal(size=15)) % 360,
        "s": sigma,
    }
    circle = ["--target", "circle", "--output", "wind", "--sigma", "s"]
    found, _ = written(tmp_path, data, *circle, *STIFF, "--picture", "fit.png")
    np.testing.assert_allclose(found["se"], line_error(found["t"], sigma), rtol=1e-3)


def posterior_of(covariance, frame, points):
    """In place of a `Posterior`."""
    return types.SimpleNamespace(
        covariance=lambda x: (covariance, frame), model=lambda x: points, scale=1.0
    )


def test_rotations_about_the_axes_of_space():
    """Rotations drawn at random about a mean turn about each axis as the columns say."""
    angles = np.radians([0.1, 0.2, 0.4])
    mean = Rotation.from_rotvec([0.3, -1.2, 0.5])
    drawn = Rotation.from_rotvec(angles * RNG.normal(size=(4000, 3)))
    about = (drawn * mean).as_matrix()
    so3 = mr.SpecialOrthogonal(3)
    # (e x) R, of length sqrt 2
    tangent = [_cross(e) @ mean.as_matrix() / np.sqrt(2) for e in np.eye(3)]
    frame = np.stack(tangent, axis=-1).reshape(1, 9, 3)
    turn = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    frame = frame @ turn
    logs = so3.log(jnp.asarray(mean.as_matrix()), jnp.asarray(about))
    covariance = np.cov((np.asarray(logs).reshape(-1, 9) @ frame[0]).T)[None]
    there = Target(so3, about, ("w", "x", "y", "z"), np.asarray, 1.0)
    posterior = posterior_of(covariance, frame, mean.as_matrix()[None])
    names, values = uncertainty(
        posterior, TargetName.rotations, there, np.zeros(1), 95.0
    )
    assert names == ["se_x", "se_y", "se_z"]
    np.testing.assert_allclose(values[0], [0.1, 0.2, 0.4], rtol=0.05)


def _cross(e):
    """The matrix of v -> e x v."""
    return np.cross(e, np.eye(3)).T


def test_what_is_not_known_is_nan():
    there = Target(mr.Euclidean(2), np.zeros((3, 2)), ("a", "b"), np.asarray, None)
    posterior = types.SimpleNamespace(scale=np.nan)
    with pytest.warns(UserWarning, match="as many parameters as data"):
        names, values = uncertainty(
            posterior, TargetName.euclidean, there, np.zeros(4), 95.0
        )
    assert names == ["se_a", "se_b"]
    assert values.shape == (4, 2) and np.isnan(values).all()
