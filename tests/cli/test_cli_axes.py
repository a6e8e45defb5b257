"""What goes into the command comes out of it: times and dates, digit by digit."""

import csv
import types
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from fractions import Fraction

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

import manireg as mr
from manireg._cli.app import app


class Line(eqx.Module):
    """In place of a fit: y = x - a on [a, b], the data are (x_i, x_i - a)."""

    source: mr.Interval

    def __call__(self, x):
        return (x - self.source.a)[:, None]

    lam = jnp.asarray(0.1 + 0.2)
    energies = types.SimpleNamespace(loss=0.0, energy=0.0, off_manifold=0.0)

    def posterior(self, smoothing="auto"):
        one = lambda x: np.ones((len(x), 1, 1))
        both = lambda x: (one(x), one(x))
        found = {"rows": lambda degrees: {}, "wavelength": 1.0}
        summary = lambda: types.SimpleNamespace(**found)
        return types.SimpleNamespace(covariance=both, scale=1.0, summary=summary)


@pytest.fixture
def written(tmp_path, monkeypatch):
    """The lines of the predictions, and what was printed."""
    reached = {}

    def fit(source, target, x, y, lam, *_, **__):
        reached["x"] = np.asarray(x)
        return Line(source), None

    monkeypatch.setattr("manireg._cli.fit.chosen_fit", fit)
    monkeypatch.chdir(tmp_path)

    def written(times, predict=40, name="time", asked=None):
        rows = "".join(f"{time},{i}\n" for i, time in enumerate(times))
        (tmp_path / "data.csv").write_text(f"{name},y\n{rows}")
        if asked is not None:
            (tmp_path / "asked.csv").write_text("\n".join([name, *asked]))
            predict = "asked.csv"
        result = CliRunner().invoke(
            app,
            ["fit", "data.csv", "--target", "euclidean", "--input", "time"]
            + [
                "--output",
                "y",
                "--lam",
                "1",
                "--out",
                "o.csv",
                "--predict",
                str(predict),
            ],
        )
        assert result.exit_code == 0, result.output + repr(result.exception)
        with (tmp_path / "o.csv").open(newline="") as file:
            header, *pairs = csv.reader(file)
        assert header == [name, "y", "se_y"]
        return [p[0] for p in pairs], [float(p[1]) for p in pairs], reached["x"], result

    return written


def test_epoch_seconds_stay_distinct(written):
    times, values, x, result = written([f"{1.7e9 + 0.05 * i:.2f}" for i in range(40)])
    expected = np.linspace(1.7e9, 1.7e9 + 1.95, 40)
    np.testing.assert_array_equal([float(t) for t in times], expected)
    assert times[0] == "1700000000" and len(set(times)) == 40
    np.testing.assert_array_equal(values, expected - 1.7e9)
    assert "0.30000000000000004" in result.output  # lambda, to be given again


@pytest.mark.parametrize(
    "start", [1403715524907143168, 1700000000123456789, -1700000000123456789]
)
@pytest.mark.parametrize("step", [1, 7, 100, 50_000_000])
def test_nanoseconds_since_1970(written, start, step):
    """Integers beyond 2^53, closer together than floats are there."""
    given = [str(start + step * i) for i in range(21)]
    asked = [given[3], given[8], str(start + 20 * step)]
    times, values, x, _ = written(given, asked=asked)
    assert times == asked
    tolerance = 0 if step < 1e6 else 256
    np.testing.assert_allclose(x - x[0], step * np.arange(21.0), atol=tolerance)
    np.testing.assert_allclose(values, [3 * step, 8 * step, 20 * step], atol=tolerance)
    times, _, _, _ = written(given, predict=41)
    assert len({Fraction(t) for t in times}) == 41
    if step < 1e6:
        assert [Fraction(t) for t in times] == [
            start + Fraction(step * i, 2) for i in range(41)
        ]


def test_seconds_with_nanoseconds(written):
    """As robots write them: 19 digits."""
    start = Decimal("1403715524.907143168")
    given = [str(start + Decimal(i).scaleb(-9)) for i in range(12)]
    times, values, x, _ = written(given, asked=given[2:5])
    assert times == given[2:5]
    np.testing.assert_array_equal(values, [2e-9, 3e-9, 4e-9])
    times, *_ = written(given, predict=12)
    assert [Decimal(t) for t in times] == [Decimal(t) for t in given]


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1.0, 1e9])
def test_units_and_origins(written, scale):
    for origin in (0.0, 449_000.125, -6_000_000.5):
        x = origin + scale * np.arange(10)
        times, *_ = written([repr(float(v)) for v in x], predict=10)
        found = np.array([float(t) for t in times])
        np.testing.assert_array_equal(found[[0, -1]], x[[0, -1]])
        assert len(set(times)) == 10


def test_dates(written):
    noon = datetime(2024, 5, 1, 12, tzinfo=UTC)
    given = [(noon + timedelta(seconds=0.25 * i)).isoformat() for i in range(9)]
    times, values, x, result = written(given, predict=17)
    printed = " ".join(result.output.split())
    assert "dates time in seconds since 2024-05-01T12:00:00Z Eells" in printed
    assert "lambda 0.30000000000000004 s^3 residual" in printed
    np.testing.assert_array_equal(x, 0.25 * np.arange(9))
    assert times[:3] == [
        "2024-05-01T12:00:00.000Z",
        "2024-05-01T12:00:00.125Z",
        "2024-05-01T12:00:00.250Z",
    ]
    assert values[-1] == 2 and times[-1] == "2024-05-01T12:00:02.000Z"


FORMS = {
    "days": ([f"2024-02-{d}" for d in (27, 28, 29)] + ["2024-03-01"], 86400),
    "months": (["2023-01", "2023-02-01", "2023-03-04", "2023-04-04"], 86400 * 31),
    "slashes": ([f"2024/2/{d}" for d in (27, 28, 29)] + ["2024/3/1"], 86400),
    "hours": ([f"2024-05-01 {h:02d}:30" for h in range(4)], 3600),
    "zones": (
        ["2024-05-01T12:00:00+02:00", "2024-05-01T11:00Z", "2024-05-01T13:00-01"]
        + ["2024-05-01T08:00-0500"],
        None,
    ),
    "commas": ([f'"2024-05-01T12:30:00,{i}"' for i in range(4)], 0.1),
    "nanoseconds": ([f"2024-05-01T12:30:00.00000000{i}Z" for i in range(4)], 1e-9),
    "centuries": ([f"{y}-01-01" for y in (1500, 1501, 1502, 1503)], 86400 * 365),
    "zone of R": ([f"2024-05-01 12:30:0{i} UTC" for i in range(4)], 1),
    "compact": ([f"20240501T12300{i}Z" for i in range(4)], 1),
    "compact times": ([f"2024-05-01T12300{i}Z" for i in range(4)], 1),
}


@pytest.mark.parametrize("form", FORMS)
def test_forms_of_dates(written, form):
    given, step = FORMS[form]
    asked = [given[2], given[1]]
    times, values, x, _ = written(given, asked=asked)
    assert times == [a.strip('"') for a in asked]
    expected = np.array([0, 1, 4, 3]) * 3600 if step is None else step * np.arange(4.0)
    np.testing.assert_allclose(x, expected, rtol=1e-12)
    np.testing.assert_allclose(values, expected[[2, 1]], rtol=1e-12)


def test_nanoseconds_are_written_back(written):
    given = [f"2024-05-01T12:30:00.123456{i:03d}" for i in (0, 100, 200, 300)]
    times, *_ = written(given, predict=301)
    expected = [f"2024-05-01T12:30:00.123456{i:03d}" for i in range(301)]
    assert times == expected


def test_numbers_that_may_be_dates(written):
    """They are numbers, as before, but it is said."""
    *_, x, result = written([20240430, 20240501, 20240502])
    np.testing.assert_array_equal(x, [20240430, 20240501, 20240502])
    assert "`time` is read as numbers. If 20240430 is a date, write" in result.stderr
    *_, result = written([20240430, 20240431, 20240499])
    assert result.stderr == ""


REFUSED = {
    "no date": (["2024-05-01", "2024-05-32"], "'2024-05-32' is no date as 2024-05-01"),
    "text": (["2024-05-01", "2024-05-02", "soon"], "'soon' is no date as 2024-05-01"),
    "zones": (
        ["2024-05-01T12:00Z", "2024-05-02T12:00"],
        "'2024-05-02T12:00' has no time zone, the first '2024-05-01T12:00Z' has one",
    ),
    "order": (
        ["01.05.2024", "02.05.2024"],
        "has text, '01.05.2024'; --input needs num",
    ),
    "number": (["1", "2", "2024-05-03"], "has text, '2024-05-03'; --input needs num"),
}


@pytest.mark.parametrize("form", REFUSED)
def test_refused_dates(tmp_path, form):
    given, message = REFUSED[form]
    file = tmp_path / "data.csv"
    file.write_text("time,y\n" + "".join(f"{t},1\n" for t in given))
    result = CliRunner().invoke(
        app,
        ["fit", str(file), "--target", "euclidean", "--input", "time", "--output", "y"],
    )
    assert result.exit_code == 2 and message in result.stderr, result.stderr
    assert f"line {len(given) + 1 if form != 'order' else 2})" in result.stderr


def test_dates_are_inputs_only(tmp_path):
    file = tmp_path / "data.csv"
    file.write_text("time,y\n1,2024-05-01\n2,2024-05-02\n")
    arguments = ["--target", "euclidean", "--input", "time", "--output", "y"]
    result = CliRunner().invoke(app, ["fit", str(file), *arguments])
    assert "has text, '2024-05-01'; --output needs numbers; dates are" in result.stderr
