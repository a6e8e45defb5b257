"""`manireg path`: columns, ages, polarity, and a table that agrees with spherical
trigonometry, scipy's rotations and smoothing splines."""

import csv
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread
from scipy.interpolate import make_smoothing_spline
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from typer.testing import CliRunner

import manireg as mr
from manireg._cli.app import app
from manireg._cli.columns import Missing
from manireg._cli.poles import read_poles
from manireg.apps._path import RADIUS, _ages
from manireg.apps._path_picture import draw
from manireg.apps._polarity import opposite
from manireg.apps._poles import checked
from manireg.datasets import read_table
from manireg.datasets._text_tables import read_text_table

SITE = -33.0, 18.0
EULER = np.array([0.6, -0.64, 0.48])
RATE = 0.9  # degrees of rotation per Myr, as time goes on


def vectors(lat, lon):
    lat, lon = np.radians(lat), np.radians(lon)
    x, y = np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon)
    return np.stack([x, y, np.sin(lat)], axis=-1)


def turned(age):
    """The south pole as a plate saw it that turned about `EULER`."""
    turn = np.radians(RATE) * np.asarray(age)[:, None] * EULER
    return Rotation.from_rotvec(turn).apply([0.0, 0.0, -1.0])


def degrees_apart(p, q):
    return np.degrees(2 * np.arcsin(np.linalg.norm(p - q, axis=-1) / 2))


def bearing(p, q):
    """From north, clockwise, in which q lies as seen from p."""
    north = np.array([0, 0, 1.0]) - p[:, 2:] * p
    east = np.cross([0, 0, 1.0], p)
    return np.degrees(np.arctan2(np.sum(east * q, 1), np.sum(north * q, 1))) % 360


def run(*arguments):
    return CliRunner().invoke(app, ["path", *map(str, arguments)])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Forty south poles, two of them turned round, through the command."""
    folder = tmp_path_factory.mktemp("path")
    random = np.random.default_rng(0)
    age = np.sort(random.uniform(0.0, 100.0, 40)).round(3)
    p = turned(age) + random.normal(size=(40, 3)) * 0.03
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    p[[5, 31]] *= -1
    lat = np.degrees(np.arcsin(p[:, 2]))
    lon = np.degrees(np.arctan2(p[:, 1], p[:, 0])) % 360
    a95 = np.full(40, 4.0)
    rows = [["Age (Ma)", "PLat", "PLong", "A95 (°)", "Rock unit"]]
    rows += [[*row, f"unit{i}"] for i, row in enumerate(zip(age, lat, lon, a95))]
    with (folder / "poles.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    files = ["--out", folder / "path.csv", "--rot", folder / "path.rot"]
    files += ["--picture", folder / "path.png", "--projection", "polar"]
    site = ["--site", "{},{}".format(*SITE), "--plate-id", 701, "--ages", "0,100,0.5"]
    result = run(folder / "poles.csv", *files, *site)
    assert result.exit_code == 0, result.output + repr(result.exception)
    python = mr.apps.path(
        mr.apps.Poles(age, lat, lon, a95),
        ages=np.arange(0, 100.1, 0.5),
        progress=False,
    )
    return folder, result.output, read_table(folder / "path.csv"), python, p


def test_same_numbers_from_python(made):
    _, _, table, python, _ = made
    columns = python.table(site=SITE)
    assert list(columns) == list(table) and len(table["age"]) == 201
    for name, values in columns.items():
        np.testing.assert_allclose(table[name], values, rtol=1e-9, atol=1e-12)


def test_path_is_near_the_truth(made):
    _, output, table, python, p = made
    truth = turned(table["age"])
    inside = python.posterior.region(table["age"]).contains(truth)
    assert inside.mean() > 0.85
    assert degrees_apart(vectors(table["lat"], table["lon"]), truth).max() < 3
    np.testing.assert_array_equal(np.flatnonzero(python.flipped), [5, 31])
    assert np.all(np.sum(python.poles.directions * p, 1)[[5, 31]] < 0)
    words = " ".join(output.split())
    assert "south poles, 2 turned round: data rows 6 (unit5), 32 (unit31)" in words
    assert "40 alone, taken as exact" in words and "A95 of 40" in words
    speed = RATE * np.linalg.norm(np.cross(EULER, truth), axis=1)
    gap = np.abs(table["rate"] - speed) / table["rate_sd"]
    assert np.mean(gap < 2) > 0.85


def test_motion_by_finite_differences(made):
    table = made[2]
    p = vectors(table["lat"], table["lon"])
    step = 2 * 0.5
    rate = degrees_apart(p[2:], p[:-2]) / step
    np.testing.assert_allclose(table["rate"][1:-1], rate, rtol=2e-3)
    # as time goes on ages fall
    away = (table["motion_azimuth"][1:-1] - bearing(p[1:-1], p[:-2]) + 180) % 360 - 180
    assert np.abs(away).max() < 0.5
    # carries the pole of the older age to where the younger was: the opposite of what
    # the plate does, which turns about `euler` counterclockwise
    older_to_younger = np.cross(p[2:], p[:-2])
    plate = -older_to_younger / np.linalg.norm(older_to_younger, axis=1, keepdims=True)
    euler = vectors(table["euler_lat"], table["euler_lon"])
    assert degrees_apart(euler[1:-1], plate).max() < 0.5
    sine = np.linalg.norm(np.cross(euler, vectors(*SITE)), axis=1)
    km = np.radians(table["rate"]) * RADIUS * sine
    np.testing.assert_allclose(table["cm_per_year"], km / 10, rtol=1e-9)


def test_without_a_site_where_the_plate_is_fastest(made):
    columns = made[3].table(np.array([20.0, 50.0]))
    fastest = columns["rate"] * 111.195 / 10  # km a degree
    np.testing.assert_allclose(columns["cm_per_year"], fastest, rtol=1e-5)


def test_ellipse_from_the_covariance(made):
    _, _, table, python, _ = made
    covariance, _ = python.posterior.covariance(table["age"])
    axes = np.sqrt(chi2.ppf(0.95, 2) * np.linalg.eigvalsh(covariance))
    np.testing.assert_allclose(table["semi_minor"], np.degrees(axes[:, 0]), rtol=1e-9)
    np.testing.assert_allclose(table["semi_major"], np.degrees(axes[:, 1]), rtol=1e-9)
    theta = np.degrees(np.sqrt(axes[:, 0] * axes[:, 1]))
    np.testing.assert_allclose(table["theta95"], theta, rtol=1e-9)
    inside = np.abs(python.poles.age - table["age"][:, None]) <= (
        table["window"][:, None] / 2
    )
    np.testing.assert_array_equal(table["poles"], inside.sum(1))


def test_rotations_carry_the_path_to_the_pole(made):
    folder, _, table, python, _ = made
    lines = (folder / "path.rot").read_text().splitlines()
    fields = [line.split("!")[0].split() for line in lines]
    assert {(f[0], f[5]) for f in fields} == {("701", "000")}
    ages, lat, lon, angle = np.array([f[1:5] for f in fields], float).T
    np.testing.assert_array_equal(ages, table["age"])
    np.testing.assert_array_equal(lat, 0)
    turn = Rotation.from_rotvec(np.radians(angle)[:, None] * vectors(lat, lon))
    moved = turn.apply(vectors(table["lat"], table["lon"]))
    np.testing.assert_allclose(moved, [[0, 0, -1]] * len(ages), atol=1e-6)
    north = mr.apps.PolePath(*python)._replace(hemisphere="north").rotations()
    turn = Rotation.from_rotvec(
        np.radians(north.angle)[:, None] * vectors(north.lat, north.lon)
    )
    moved = turn.apply(vectors(table["lat"], table["lon"]))
    np.testing.assert_allclose(moved, [[0, 0, 1]] * len(ages), atol=1e-9)


def test_pictures(made, tmp_path):
    folder, *_, python, _ = made
    assert imread(folder / "path.png").shape[0] > 1000
    mr.plot.save(python.picture(), tmp_path / "globe.pdf")
    assert (tmp_path / "globe.pdf").stat().st_size > 10_000
    with pytest.raises(ValueError, match="expected 'globe' or 'polar', found 'flat'"):
        draw(python, "flat", 0.95)


def test_at_a_wavelength(made):
    _, _, _, python, p = made
    lat = np.degrees(np.arcsin(p[:, 2]))
    lon = np.degrees(np.arctan2(p[:, 1], p[:, 0]))
    poles = mr.apps.Poles(python.poles.age, lat, lon, python.poles.a95)
    found = mr.apps.path(poles, age_step=20.0, wavelength=40.0, hemisphere="north")
    assert found.posterior.summary().wavelength == pytest.approx(40.0)
    assert found.choice is None and found.hemisphere == "north"
    np.testing.assert_array_equal(found.ages, [0, 20, 40, 60, 80, 100])
    # none is flipped here, so the path runs half way between both polarities
    mixed = mr.apps.path(poles, wavelength=40.0, flip="none")
    assert not mixed.flipped.any()
    assert mixed.posterior.summary().sigma > 3 * found.posterior.summary().sigma


def test_equal_area():
    globe = mr.plot.globe(view=(0, 0, 1), graticule=0, equal_area=True)
    for colatitude in (5.0, 60.0, 90.0):
        place, _ = globe.flatten(vectors(np.array([90 - colatitude]), [40.0]))
        share = 1 - np.cos(np.radians(colatitude))  # of the area of the hemisphere
        assert np.sum(place**2) == pytest.approx(share)


def test_effective_number_by_a_smoothing_spline():
    """Leverages of scipy's smoothing spline: those of the same linear problem."""
    x, k = np.linspace(0, 100, 81), 81
    y = np.sin(x / 15)[:, None]
    wavelength = 30.0
    source = mr.Interval(0, 100)
    model = mr.fit(source, mr.Euclidean(1), x, y, wavelength=wavelength)
    lam = float(model.lam)
    assert lam == pytest.approx((wavelength / (2 * np.pi)) ** 4 / 100)
    at = np.array([0, 7, 40, 80])
    kernel = model.posterior("known").equivalent_kernel(x[at])
    hat = [make_smoothing_spline(x, row, lam=lam * k)(x) for row in np.eye(k)]
    leverage = np.diag(np.array(hat))[at]
    np.testing.assert_allclose(kernel.number, 1 / leverage, rtol=0.02)
    # sqrt 2 / pi of the wavelength, and so many poles lie in it
    assert kernel.width[2] == pytest.approx(np.sqrt(2) / np.pi * wavelength, rel=0.02)
    assert kernel.number[2] == pytest.approx(kernel.width[2] * k / 100, rel=0.02)


@pytest.mark.parametrize("order", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_wavelength_halves_a_wave(order):
    x = (np.arange(80) + 0.5) / 8
    source, line = mr.Interval(0, 10), mr.Euclidean(1)
    for length, left in ((1.0, 0.5), (2.0, 1 / (1 + 0.5 ** (2 * order)))):
        y = np.sin(2 * np.pi * x / length)
        model = mr.fit(source, line, x, y[:, None], wavelength=1.0, order=order)
        fitted = np.asarray(model(x))[:, 0]
        middle = (x >= 3) & (x < 7)  # whole periods
        height = 2 * np.mean(fitted[middle] * y[middle])
        assert height == pytest.approx(left, rel=0.01)


def test_wavelength_beside_lam():
    x = np.linspace(0, 8, 80)
    y = np.cos(x)[:, None]
    problem = mr.make_problem(mr.Interval(0, 8), mr.Euclidean(1), x, y)
    by_length = mr.solve(problem, wavelength=3.0)
    assert float(by_length.lam) == pytest.approx((3 / (2 * np.pi)) ** 4 / 8)
    assert by_length.summary().wavelength == pytest.approx(3.0)
    again = mr.solve(problem, float(by_length.lam))
    np.testing.assert_allclose(again(x), by_length(x), atol=1e-12)
    with pytest.raises(ValueError, match="lam, wavelength: both say how smooth"):
        mr.solve(problem, 1.0, wavelength=3.0)
    with pytest.raises(ValueError, match="lam: missing; give it, or `wavelength`"):
        mr.solve(problem)
    with pytest.raises(ValueError, match="wavelength: a wavelength must be positive"):
        mr.solve(problem, wavelength=-1.0)


def test_wavelength_of_fit_at_the_shell(tmp_path, monkeypatch):
    x = np.linspace(0, 8, 80)
    rows = "\n".join(f"{a},{np.cos(a)}" for a in x)
    (tmp_path / "wave.csv").write_text(f"t,y\n{rows}")
    monkeypatch.chdir(tmp_path)
    line = ["--target", "euclidean", "--input", "t", "--output", "y"]
    result = CliRunner().invoke(app, ["fit", "wave.csv", *line, "--wavelength", "3"])
    words = " ".join(result.output.split())
    assert "wavelength 3 " in words, result.output + repr(result.exception)
    both = ["--wavelength", "3", "--lam", "1"]
    result = CliRunner().invoke(app, ["fit", "wave.csv", *line, *both])
    assert "lam, wavelength: both say how smooth the map is" in result.stderr


def read(tmp_path, header, rows, lat_lon=None, column=(), where=()):
    file = tmp_path / "poles.csv"
    file.write_text("\n".join([header, *rows]))
    table = read_text_table(file)
    return read_poles(table, lat_lon, column, where, Missing.drop)


@pytest.mark.parametrize(
    "header",
    [
        "age,min_age,max_age,lat,lon,A95",
        "Mean age,AGE_MIN,Age_Max,PLAT,PLON,a95",
        "nominal_age,low age,high age,pole_lat_deg,Pole_Long,alpha95",
        "Age (Ma),LOMAGAGE,HIMAGAGE,Pole latitude [°N],pole longitude,α95 (°)",
    ],
)
def test_usual_names(tmp_path, header):
    poles = read(tmp_path, header, ["10,8,13,-80,20,5", "20,,,-70,30,4"]).poles
    data = checked(poles, 0.5)
    np.testing.assert_array_equal(data.age, [10, 20])
    np.testing.assert_array_equal(data.age_min, [8, np.nan])
    np.testing.assert_array_equal(data.age_sigma, [np.nan, 0.5])
    np.testing.assert_allclose(data.directions, vectors([-80, -70], [20, 30]))
    np.testing.assert_array_equal(data.a95, [5, 4])
    assert data.bounds == (8, 21.5)


def test_other_names_and_rows(tmp_path):
    rows = ["10,-80,20,north", "20,-70,30,south", "30,-60,31,South"]
    names = ["age=T", "lat=y", "lon=x"]
    found = read(tmp_path, "T,y,x,plate", rows, column=names, where=["plate=south"])
    np.testing.assert_array_equal(found.poles.age, [20, 30])
    assert found.precision == "none given: all poles count alike"
    assert checked(found.poles, 0).of_noise == {}


def test_precision_from_what_there_is(tmp_path):
    rows = ["1,0,0,5,99,9,9,9", "2,0,0,,50,8,9,9", "3,0,0,0,,8,4,9", "4,0,0,,,,,"]
    found = read(tmp_path, "age,lat,lon,A95,K,N,dp,dm", rows)
    expected = [5, np.degrees(np.sqrt(2 * np.log(20))) / 20, 6, np.nan]
    np.testing.assert_allclose(found.poles.a95, expected)
    median = np.median(expected[:3])
    a95 = checked(found.poles, 0).a95
    assert a95 is not None
    np.testing.assert_allclose(a95, [*expected[:3], median])
    assert found.precision == (
        "A95 of 1, K and N of 1, dp and dm of 1, none of 1: the median of the others, 6 "
        "degrees"
    )


def test_any_mix_of_ages(tmp_path):
    rows = [
        "10,8,13,,,0,0",
        "20,,,2,,0,0",
        "30,28,32,,3,0,0",
        "40,,,,,0,0",
        ",5,7,,,0,0",
    ]
    header = "age,min_age,max_age,age_sigma,age_2sigma,lat,lon"
    data = checked(read(tmp_path, header, rows).poles, 0.0)
    np.testing.assert_array_equal(data.age, [10, 20, 30, 40, 6])
    np.testing.assert_array_equal(data.age_sigma, [np.nan, 2, 1.5, 0, np.nan])
    np.testing.assert_array_equal(data.age_max, [13, np.nan, np.nan, np.nan, 7])
    assert set(data.of_ages) == {"x_sigma", "x_min", "x_max"}
    # a word in the table decides
    rows = ["10,9,11,1,uniform,0,0", "20,19,21,1,gaussian,0,0"]
    header = "age,min_age,max_age,age_sigma,distribution,lat,lon"
    data = checked(read(tmp_path, header, rows).poles, 0.0)
    np.testing.assert_array_equal(data.age_sigma, [np.nan, 1])


def test_age_outside_its_range_moves_to_the_nearer_end():
    poles = mr.apps.Poles([10, 50], [0, 0], [0, 0], age_min=[8, 40], age_max=[12, 44])
    data = checked(poles, 0.0)
    np.testing.assert_array_equal(data.age, [10, 44])
    np.testing.assert_array_equal(data.moved, [False, True])


MISTAKES = [
    ("age,lat,lon,plat,plon", "1,2,3,4,5", "several columns that may be the pole: lat, pl"
     "at and lon, plon"),
    ("age,lat,lon,plat,plon", "1,2,3,4,5", "--lat-lon lat,lon or --lat-lon plat,plon."),
    ("lat,lon", "1,2", "has no column of ages"),
    ("age,x,y", "1,2,3", "has no columns of poles"),
    ("min_age,lat,lon", "1,2,3", "has no column of ages"),
    ("age,min_age,lat,lon", "1,2,3,4", "one end of a range of ages; name the other"),
    ("age,mean_age,lat,lon", "1,2,3,4", "may be age: age, mean_age. Say which: --column "
     "age=age."),
    ("age,lat,lon", "-3,2,3", "not negative (Ma before present), but column `age` has -3 i"
     "n data row 1. Mend the row (line 2)."),
    ("min_age,max_age,lat,lon", "5,3,2,3", "min_age must not exceed max_age, but column `m"
     "in_age` has 5 in data row 1."),
    ("age,min_age,max_age,lat,lon", "5,3,,2,3", "a range of ages has both ends"),
    ("min_age,max_age,lat,lon", ",,2,3", "each row needs an age, or a range"),
    ("age,lat,lon", "1,93,3", "leaves [-90, 90] degrees"),
    ("age,lat,lon,A95", "1,2,3,-4", "a95 is not negative, but column `A95` has -4"),
    ("age,lat,lon", "old,2,3", "column `age` has text, 'old'"),
]  # fmt: skip


@pytest.mark.parametrize(("header", "row", "message"), MISTAKES)
def test_mistakes(tmp_path, header, row, message):
    with pytest.raises(ValueError) as caught:
        read(tmp_path, header, [row])
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--site", "north"],
            "--site takes a latitude and a longitude, such as -33,18",
        ),
        (
            ["--site", "99,18"],
            "site: a latitude and a longitude in degrees, found 99, 18",
        ),
        (["--plate-id", 0], "plate_id, fixed_id: two whole numbers"),
        (["--ages", "0,5"], "--ages takes from,to,step in Ma"),
        (["--ages", "5,0,1"], "--ages 5,0,1: from is 0 or more"),
        (
            ["--column", "time=age"],
            "--column time=age: expected NAME=COLUMN with one of",
        ),
        (["--where", "plate=x"], "no column `plate` for --where"),
        (["--where", "age=7"], "no such row; `age` has 1, 2."),
        (["--out", "poles.csv"], "is a table to read; name another file"),
        (["--lat-lon", "lat"], "--lat-lon takes two columns, found 1"),
    ],
)
def test_options_that_cannot_be(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "poles.csv").write_text("age,lat,lon\n1,80,0\n2,79,0\n")
    result = run("poles.csv", *arguments)
    assert result.exit_code == 2
    assert message in result.stderr, result.output + repr(result.exception)


def test_python_refuses(unchecked):
    def refused(**columns):
        given = {"age": [1.0, 2, 3], "lat": [0.0, 0, 0], "lon": [0.0, 0, 0]} | columns
        with pytest.raises(ValueError) as caught:
            checked(mr.apps.Poles(**given), 0.0)
        return str(caught.value)

    assert "lat: must lie in [-90, 90] degrees (found 91 at ind" in refused(
        lat=[0, 91, 0]
    )
    assert "lon: expected shape (3,), one for each age" in refused(lon=[0, 1])
    assert "age: older than the Earth; give ages in Ma" in refused(age=[1, 2, 2.5e8])
    assert "age: missing; give an age or a range" in refused(age=[1, 2, np.nan])
    low, high = [0, 3, 1], [2, 2, 4]
    assert "age_min: must not exceed age_max" in refused(age_min=low, age_max=high)
    assert "give both ends of a range" in refused(age_min=low)
    with pytest.raises(ValueError, match="flip: expected 'auto' or 'none'"):
        mr.apps.path(mr.apps.Poles([1], [0], [0]), flip="all")  # type: ignore[arg-type]


def test_polarity_of_a_path_that_goes_far():
    """Over both hemispheres; of random polarity, but for one the more common."""
    random = np.random.default_rng(1)
    age = random.uniform(0, 150, 60)
    p = turned(age * 1.5) + 0.1 * random.normal(size=(60, 3))
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    assert not opposite(age, p).any()
    for share in (0.1, 0.4):
        signs = np.where(random.uniform(size=60) < share, -1.0, 1.0)
        assert (signs < 0).sum() < 30
        np.testing.assert_array_equal(opposite(age, signs[:, None] * p), signs < 0)


def test_default_ages():
    np.testing.assert_array_equal(
        _ages(np.array([0.5, 329.0]), None), np.arange(0, 331, 10)
    )
    np.testing.assert_array_equal(
        _ages(np.array([1070.0, 1109.0]), None), np.arange(1070, 1110)
    )
    np.testing.assert_array_equal(
        _ages(np.array([2.0, 3.0]), 0.2), np.arange(10, 16) / 5
    )
    with pytest.raises(ValueError, match="no multiple of 10 lies within 12 to 17 Ma"):
        _ages(np.array([12.0, 17.0]), 10.0)


TABLES = {
    "s2_poles_torsvik2012.csv": ["--where", "gondwana=1"],
    "s2_poles_australia_cenozoic.csv": [],  # two ages normal, ten uniform
}


@pytest.mark.slow
@pytest.mark.parametrize("name", TABLES)
def test_raw_tables(data_folder, tmp_path, name):
    """The numbers of the table by the posterior of `mr.fit`, called as users would."""
    file = data_folder / "tables" / name
    raw = read_table(file)
    result = run(
        file, *TABLES[name], "--out", tmp_path / "p.csv", "--rot", tmp_path / "p.rot"
    )
    assert result.exit_code == 0, result.output + repr(result.exception)
    table = read_table(tmp_path / "p.csv")
    assert all(np.isfinite(column).all() for column in table.values())
    options: dict[str, Any] = {}
    if "gondwana" in raw:
        raw = {n: c[raw["gondwana"] == 1] for n, c in raw.items()}
        a95, bounds = raw["a95"], (raw["age"].min(), raw["age"].max())
    else:
        normal = raw["distribution"] == "gaussian"
        options = {
            "x_sigma": np.where(normal, raw["sigma2_age"] / 2, np.nan),
            "x_min": np.where(normal, np.nan, raw["min_age"]),
            "x_max": np.where(normal, np.nan, raw["max_age"]),
        }
        a95, bounds = raw["A95"], (0.0, np.max(raw["max_age"]))
    ages, y = table["age"], vectors(raw["lat"], raw["lon"])
    source = mr.Interval(min(bounds[0], ages[0]), max(bounds[1], ages[-1]))
    model = mr.fit(
        source,
        mr.Sphere(2),
        raw["age"],
        y,
        sigma=mr.from_a95(a95),
        criterion="reml",
        progress=False,
        **options,
    )
    path = vectors(table["lat"], table["lon"])
    np.testing.assert_allclose(path, model(ages), atol=1e-9)
    posterior = model.posterior()
    np.testing.assert_allclose(
        table["theta95"], posterior.region(ages).theta95, rtol=1e-6
    )
    motion = posterior.sphere_motion(ages)
    np.testing.assert_allclose(table["rate"], np.degrees(motion.speed), rtol=1e-6)
    rate_sd = np.degrees(motion.speed_deviation)
    np.testing.assert_allclose(table["rate_sd"], rate_sd, rtol=1e-6)
    fields = [
        line.split()[1:5] for line in (tmp_path / "p.rot").read_text().splitlines()
    ]
    when, lat, lon, angle = np.array(fields, float).T
    turn = Rotation.from_rotvec(np.radians(angle)[:, None] * vectors(lat, lon))
    geographic = np.sign(table["lat"][0]) * np.array([0, 0, 1.0])
    assert np.abs(turn.apply(path) - geographic).max() < 1e-6
    np.testing.assert_array_equal(when, ages)


@pytest.mark.slow
def test_vaes_at_a_wavelength(data_folder, tmp_path):
    """705 poles, of two pairs of coordinates, with and without ranges of age and A95;
    near the published running means over 20 Myr."""
    file = data_folder / "tables" / "s2_poles_vaes2023.csv"
    both = run(file)
    assert "Say which: --lat-lon plat,plon or --lat-lon lat,lon." in both.stderr
    out = ["--out", tmp_path / "p.csv", "--wavelength", 50, "--ages", "10,320,10"]
    result = run(file, "--lat-lon", "lat,lon", *out)
    words = " ".join(result.output.split())
    assert "664 within a range, 41 alone, taken as exact" in words, result.output
    assert "4, taken at its nearer end" in words and "A95 of 400, none of 305" in words
    table = read_table(tmp_path / "p.csv")
    published = read_table(data_folder / "tables" / "s2_path_vaes2023.csv")
    path = vectors(table["lat"], table["lon"])
    gap = degrees_apart(path, vectors(published["plat"], published["plon"])[1:])
    assert np.median(gap) < 2.5
    assert 15 < np.median(table["window"]) < 30
    assert np.mean(gap < np.hypot(table["theta95"], published["V95"][1:])) > 0.6
