"""What users have becomes float64 numbers, or is refused with its place."""

# wrong types are the point here
# pyright: reportArgumentType=false

import datetime
from decimal import Decimal
from fractions import Fraction
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import manireg as mr
from manireg._input.numbers import as_numbers, numbers_and_unit
from manireg._sources.sources import listed
from manireg.baselines import geodesic_regression, nadaraya_watson, volume_spline

INTERVAL, LINE, SPHERE = mr.Interval(0, 1), mr.Euclidean(1), mr.Sphere(2)
X = np.linspace(0.1, 0.9, 9)
Y = np.stack([np.cos(X), np.sin(X), 0 * X], axis=1)
DAY = 86400.0
NOON = 1577880000.0  # 2020-01-01 12:00 UTC in seconds since 1970, by `date`
CET = datetime.timezone(datetime.timedelta(hours=1))
NAN = np.nan


def masked(array, index):
    result = np.ma.array(array)
    result[index] = np.ma.masked
    return result


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([1, 2**40], [1, 2.0**40]),
        (np.arange(3, dtype=np.uint8), [0, 1, 2]),
        (np.float32([0.5, 0.1]), [0.5, float(np.float32(0.1))]),
        ([Decimal("0.1"), Fraction(1, 3), 2, 3.5], [0.1, 1 / 3, 2, 3.5]),
        (np.array([1, None, 2.5], dtype=object), [1, NAN, 2.5]),
        ([np.ones(2), None, jnp.zeros(2)], [[1, 1], [NAN, NAN], [0, 0]]),
        ([(1, 2), [Decimal(3), 4]], [[1, 2], [3, 4]]),
        (np.ma.array([1.0, 2.0], mask=False), [1, 2]),
        (np.arange(6.0).reshape(2, 3).T[::2], [[0, 3], [2, 5]]),
        ([10**400, 1], [np.inf, 1]),
        (Rotation.from_rotvec([[0, 0, np.pi]]), [[[-1, 0, 0], [0, -1, 0], [0, 0, 1]]]),
        ([Rotation.identity(), Rotation.identity()], [np.eye(3), np.eye(3)]),
    ],
)
def test_numbers(values, expected):
    found = as_numbers("x", values)
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, expected, rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize(
    ("values", "expected", "unit"),
    [
        (np.array(["2020-01-01T12"], "datetime64[h]"), [NOON], "since 1970-01-01"),
        (np.array(["2020-01-01T12:00:00.25"], "M8[ns]"), [NOON + 0.25], "since 1970"),
        (np.array(["1600", "NaT"], "M8[Y]"), [-11676096000.0, NAN], "since 1970"),
        ([datetime.datetime(2020, 1, 1, 12)], [NOON], "since 1970"),
        ([datetime.datetime(2020, 1, 1, 13, tzinfo=CET), None], [NOON, NAN], "since"),
        ([datetime.date(2020, 1, 1)], [NOON - DAY / 2], "since 1970"),
        (np.array([3, 4], "m8[D]"), [3 * DAY, 4 * DAY], "seconds"),
        ([datetime.timedelta(milliseconds=250)], [0.25], "seconds"),
    ],
)
def test_dates(values, expected, unit):
    found, told = numbers_and_unit("x", values)
    np.testing.assert_allclose(found, expected, rtol=1e-15)
    assert unit in told
    with pytest.raises(ValueError, match="x: expected real numbers, found dates"):
        as_numbers("x", values)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (masked([1.0, 2.0, 3.0], 1), "x: 1 of 3 points hold masked .* index 1"),
        (masked(np.ones((4, 2)), (3, 0)), "x: 1 of 4 points hold masked .* index 3"),
        ([np.ma.array([1, 2]), masked([1, 2], 0)], "1 of 2 .* masked .* index 1"),
        ([1.0, np.ma.masked], "x: 1 of 2 points hold masked .* index 1"),
        (np.ma.masked, "x: is masked"),
        ([True, False], "x: expected real numbers, found dtype bool"),
        ([1.0, None, True], "x: expected real numbers, found True at index 2"),
        ([1j, 2.0], "x: expected real numbers, found dtype complex128"),
        ([0.5, "0.7"], r"x: expected real numbers, found dtype <U\d+ .* index 1"),
        (
            np.array([1.0, "b"], object),
            "x: expected real numbers, found 'b' at index 1",
        ),
        ({"a": 1.0}, "x: expected real numbers, found a dict"),
        ([1.0, object()], "x: expected real numbers, found a object at index 1"),
        (np.zeros(2, [("a", float), ("b", int)]), "records with the fields a, b"),
        (
            [np.ones(2), np.ones(2), np.ones(3)],
            r"\(2,\) at index 0 and \(3,\) at index 2",
        ),
        ([np.ones((2, 2)), np.ones((2, 3))], r"\(2, 2\) at index 0 and \(2, 3\) at in"),
        (
            [datetime.date(2020, 1, 1), 1.0],
            "dates, durations and numbers are mixed .* 1",
        ),
        (np.array([1], "m8[M]"), "durations in the unit 'M' have no length"),
        (np.array([1], "m8"), "durations in the unit 'generic' have no length"),
    ],
)
def test_refused(values, message):
    with pytest.raises(ValueError, match=message):
        numbers_and_unit("x", values)


def test_pandas():
    pd: Any = pytest.importorskip("pandas")
    same = lambda found, expected: np.testing.assert_array_equal(found, expected)
    same(as_numbers("x", pd.Series([1, 2], index=[7, 3])), [1, 2])
    for dtype in ("Int64", "Float64", "object"):
        same(as_numbers("x", pd.Series([1, pd.NA, 3], dtype=dtype)), [1, NAN, 3])
    frame = pd.DataFrame({"a": pd.array([1, None], dtype="Int64"), "b": [0.5, 0.25]})
    same(as_numbers("x", frame), [[1, 0.5], [NAN, 0.25]])
    vectors = pd.Series([np.ones(2), np.zeros(2)])
    same(as_numbers("x", vectors), [[1, 1], [0, 0]])
    with pytest.raises(
        ValueError, match="y: 1 of 9 points hold NaN .*missing.* index 4"
    ):
        values = pd.Series([*X[:4], None, *X[5:]], dtype="Float64")
        mr.make_problem(INTERVAL, LINE, X, values.to_frame())
    with pytest.raises(ValueError, match="found True at index 0"):
        as_numbers("x", pd.Series([True, None], dtype="boolean"))
    noon = pd.Timestamp("2020-01-01 12:00")
    for times in (
        pd.Series([noon, pd.NaT]),
        pd.DatetimeIndex([noon, pd.NaT]),
        pd.Series([noon, pd.NaT]).dt.tz_localize("UTC").dt.tz_convert("Asia/Tokyo"),
        [noon, pd.NaT],
    ):
        same(numbers_and_unit("x", times)[0], [NOON, NAN])
    assert mr.Interval(noon, noon + pd.Timedelta(days=1)).b == NOON + DAY


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: mr.fit(INTERVAL, SPHERE, masked(X, 4), Y, 1e-3), "x: 1 of 9 "),
        (lambda: mr.fit(INTERVAL, SPHERE, X, masked(Y, (4, 1)), 1e-3), "y: 1 of 9 "),
        (
            lambda: mr.fit(INTERVAL, SPHERE, X, Y, 1e-3, weights=masked(X, 4)),
            "weights: 1 of 9 ",
        ),
        (lambda: mr.fit(INTERVAL, SPHERE, X, Y, masked([0.1], 0)), "lam: 1 of 1 "),
        (
            lambda: mr.fit(SPHERE, LINE, list(masked(Y, 4)), X[:, None], 1e-3),
            "x: 1 of 9 ",
        ),
        (
            lambda: mr.cross_validate(INTERVAL, SPHERE, X, Y, masked([0.1, 1, 2], 1)),
            "lams: 1 of 3 ",
        ),
        (lambda: mr.geodesic(SPHERE, masked(Y, 4), Y), "p: 1 of 9 "),
        (lambda: nadaraya_watson(INTERVAL, SPHERE, X, masked(Y, 4), 0.1), "y: 1 of 9 "),
        (lambda: geodesic_regression(INTERVAL, SPHERE, masked(X, 4), Y), "x: 1 of 9 "),
        (lambda: mr.PointCloud(masked(Y, 4), Y), "points: 1 of 9 "),
        (lambda: mr.PointCloud(Y, masked(Y, 4)), "normals: 1 of 9 "),
        (lambda: mr.Interval(np.ma.masked, 1.0), "Interval: is "),
        (lambda: mr.Box(masked([0.0, 1.0], 1), [2, 2]), "Box: 1 of 2 "),
    ],
)
def test_masked_entries_are_refused_everywhere(call, name):
    with pytest.raises(ValueError, match=f"{name}.*masked"):
        call()


def test_masked_positions(ball):
    with pytest.raises(ValueError, match="source_landmarks: 1 of 9 .* index 4"):
        volume_spline(Y, masked(Y, 4), Y, ball)


@pytest.fixture(scope="module")
def ball():
    points = np.asarray(SPHERE.random_points(jax.random.key(0), 200))
    return mr.PointCloud(points, points)


def test_dates_are_seconds():
    """The same map as of plain seconds, and the unit is told."""
    start = np.datetime64("2020-01-01T12:00")
    days = start + (8 * X * DAY).astype("m8[s]")
    dates = mr.Interval(start, start + np.timedelta64(8, "D"))
    seconds = mr.Interval(NOON, NOON + 8 * DAY)
    assert dates == seconds
    lam = 1e-4 * (8 * DAY) ** 3
    model = mr.fit(dates, LINE, days, X[:, None] ** 2, lam, centres=10)
    plain = mr.fit(
        seconds, LINE, NOON + np.round(8 * X * DAY), X[:, None] ** 2, lam, centres=10
    )
    np.testing.assert_array_equal(model(days), plain(np.asarray(plain_times(days))))
    np.testing.assert_array_equal(model(days[3]), model(days)[3])
    with pytest.raises(ValueError, match="1 of 1 .*1609502400, in seconds since 1970"):
        model(np.datetime64("2021-01-01T12:00"))
    with pytest.raises(ValueError, match=r"y: expected real numbers, found dates"):
        mr.fit(dates, SPHERE, days, np.tile(days[:, None], (1, 3)), lam)


def plain_times(days):
    return days.astype("M8[s]").astype(float)


def test_rotations_of_scipy():
    turns = Rotation.from_rotvec(np.outer(X, [0.3, -0.2, 0.5]))
    so3 = mr.SpecialOrthogonal(3)
    given = mr.make_problem(INTERVAL, so3, X, turns, centres=10)
    matrices = mr.make_problem(INTERVAL, so3, X, turns.as_matrix(), centres=10)
    np.testing.assert_array_equal(given.y, matrices.y)
    with pytest.raises(ValueError, match=r"y: expected shape \(k, 3\) for Sphere"):
        mr.make_problem(INTERVAL, SPHERE, X, turns)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.0, "1"),
        (1732118400.05, "1732118400.05"),
        (0.1 + 0.2, "0.30000000000000004"),
        (np.float32(0.1), "0.1"),
        (1e-9, "1e-09"),
        ((0.0, 1.5), "[0, 1.5]"),
        (np.array([[1.0, 2.0]]), "[[1, 2]]"),
        (3, "3"),
    ],
)
def test_shown(value, text):
    assert listed(value) == text


def test_bounds_are_shown_with_all_digits():
    source = mr.Interval(1732118400.0, 1732118402.05)
    with pytest.raises(
        ValueError, match=r"\[1732118400, 1732118402.05\] .*1732118402.1"
    ):
        mr.make_problem(source, LINE, 1732118402.1 - np.arange(9.0), np.zeros((9, 1)))
    box = mr.Box([0, 5e6], [1, 5000000.25])
    with pytest.raises(ValueError, match=r"box \[0, 5000000\] to \[1, 5000000.25\]"):
        mr.make_problem(box, LINE, np.ones((9, 2)), np.zeros((9, 1)))


def test_bounds_far_from_the_origin_allow_rounding():
    start, step = 1732118400.0, 0.05
    source = mr.Interval(start, start + 40 * step)
    times = start + step * np.arange(41)
    times[-1] = np.nextafter(times[-1], np.inf)
    mr.make_problem(source, LINE, times, np.zeros((41, 1)))


# Predictions


@pytest.fixture(scope="module")
def model():
    return mr.fit(INTERVAL, SPHERE, X, Y, 1e-4, centres=10)


@pytest.fixture(scope="module")
def on_sphere():
    return mr.fit(SPHERE, LINE, Y + 0, X[:, None], 1e-3, centres=30)


def test_a_single_point_gives_a_single_point(model):
    whole = model(X)
    assert model(X[3]).shape == (3,)
    np.testing.assert_allclose(model(float(X[3])), whole[3], atol=1e-15)
    np.testing.assert_allclose(model(X.tolist()), whole, atol=1e-15)


def test_transformations_take_the_model(model):
    whole = model(X)
    for transformed in (jax.vmap(model), jax.jit(model), jax.jit(jax.vmap(model))):
        np.testing.assert_allclose(transformed(jnp.asarray(X)), whole, atol=1e-13)
    slope = jax.jacfwd(model)(jnp.asarray(X[3]))
    h = 1e-4
    central = (model(X[3] + h) - model(X[3] - h)) / (2 * h)
    np.testing.assert_allclose(slope, central, atol=1e-6)
    first = jax.grad(lambda x: model(x)[0])(X[3])
    np.testing.assert_allclose(first, slope[0], atol=1e-12)


@pytest.mark.parametrize("bad", [1.5, -0.001, np.nan, np.inf])
@pytest.mark.parametrize("transform", [eqx.filter_jit, jax.vmap])
def test_traced_points_outside_are_run_time_errors(model, transform, bad):
    with pytest.raises(Exception, match=r"x: some points lie outside the interval"):
        jax.block_until_ready(transform(model)(jnp.array([0.5, bad])))


def test_traced_shapes_are_checked(model):
    with pytest.raises(ValueError, match=r"x: expected shape \(k,\) for the interval"):
        jax.jit(model)(jnp.ones((3, 2)))


def test_known_points_are_checked_inside_of_jit(on_sphere):
    inside = jax.jit(lambda shift: on_sphere(Y) + shift)(0.0)
    np.testing.assert_allclose(inside, on_sphere(Y), atol=1e-13)
    with pytest.raises(ValueError, match="x: 9 of 9 points lie off Sphere"):
        jax.jit(lambda shift: on_sphere(1.1 * Y) + shift)(0.0)


def test_cover_is_one_rule():
    """What a problem is built on is what its map can be asked for."""
    with pytest.raises(ValueError, match="centres: .* the support of every"):
        mr.make_problem(INTERVAL, LINE, X, X[:, None], centres=10, width=0.56)
    narrow = mr.fit(INTERVAL, LINE, X, X[:, None], 1e-3, centres=10, width=0.7)
    new = np.linspace(0, 1, 101)
    np.testing.assert_allclose(narrow(new)[:, 0], new, atol=1e-6)
    np.testing.assert_allclose(jax.jit(narrow)(new)[:, 0], new, atol=1e-6)
