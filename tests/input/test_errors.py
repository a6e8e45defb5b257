"""Bad input, one mistake each: the message says what was found and what to do."""

# wrong types are the point here
# pyright: reportArgumentType=false, reportIncompatibleMethodOverride=false

import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import manireg as mr

INTERVAL, LINE, SPHERE = mr.Interval(0, 1), mr.Euclidean(1), mr.Sphere(2)
X = np.linspace(0.1, 0.9, 9)
Y = np.stack([np.cos(X), np.sin(X), 0 * X], axis=1)
Z = X[:, None] ** 2


def problem(x=X, y=Y, source=INTERVAL, target=SPHERE, **options):
    return mr.make_problem(source, target, x, y, centres=10, **options)


def replaced(array, index, value):
    array = array.copy()
    array[index] = value
    return array


@pytest.mark.parametrize(
    ("x", "y", "message"),
    [
        (np.c_[X, X], Y, r"x: expected shape \(k,\) for the interval \[0, 1\], found \("),
        (X, Y[:, :2], r"y: expected shape \(k, 3\) for Sphere, found \(9, 2\)"),
        (X, Y[:5], "y: expected 9 points, one for each input, found 5"),
        (replaced(X, 3, np.nan), Y, "x: 1 of 9 points hold NaN or infinity .* index 3"),
        (X, replaced(Y, [2, 5], np.inf), "y: 2 of 9 points hold NaN .* index 2"),
        (X, 1.01 * Y, "y: 9 of 9 points lie off Sphere .*up to 0.01 away.*M.project"),
        (X + 0.5, Y, r"x: 4 of 9 points lie outside the interval \[0, 1\] .* widen it"),
        (X[:1], Y[:1], "x: 1 distinct inputs are too few; .* needs at least 2"),
        (0 * X, Y, "x: 1 distinct inputs are too few"),
        (X.astype(str), Y, "x: expected real numbers, found dtype <U"),
        (X, Y.astype(str), "y: expected real numbers, found dtype <U"),
        (X, 1j * Y, "y: expected real numbers, found dtype complex128"),
    ],
    ids=[
        "x shape", "y shape", "lengths", "NaN", "infinity", "off target",
        "outside source", "few", "equal inputs", "strings x", "strings y",
        "complex",
    ],
)  # fmt: skip
def test_data(x, y, message):
    with pytest.raises(ValueError, match=message):
        problem(x, y)


def test_points_off_a_curved_source():
    with pytest.raises(
        ValueError, match="x: 9 of 9 points lie off Sphere .*up to 0.1 a"
    ):
        problem(1.1 * Y, Z, SPHERE, LINE)


def test_too_few_points_for_a_surface():
    with pytest.raises(ValueError, match="source of dimension 2 needs at least 4"):
        problem(Y[:3], Z[:3], SPHERE, LINE)


@pytest.mark.parametrize("lam", [-1.0, 0.0, np.nan, np.inf])
def test_lambda(lam):
    with pytest.raises(
        ValueError, match="lam: lambda must be positive and finite, foun"
    ):
        mr.fit(INTERVAL, LINE, X, Z, lam, centres=10)


def test_lambda_of_a_grid():
    with pytest.raises(ValueError, match="lams: lambda must be positive and finite"):
        mr.cross_validate(INTERVAL, LINE, X, Z, [1e-3, -1.0], folds=3, centres=10)


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        (
            -X,
            "weights: must be positive or zero.*; 9 of 9 are not, first -0.1 at index 0",
        ),
        (replaced(X, 4, -np.inf), "weights: must be positive.*first -inf at index 4"),
        (0 * X, "weights: their sum is 0; only ratios matter"),
        (
            replaced(0 * X, [1], 1.0),
            "x: 1 distinct inputs of positive weight are too",
        ),
        (replaced(X, 0, np.nan), "weights: must be positive"),
        (X[:4], r"weights: expected shape \(9,\), one for each pair, found \(4,\)"),
        (Z, r"weights: expected shape \(9,\), one for each pair, found \(9, 1\)"),
    ],
    ids=["negative", "infinite", "all zero", "one left", "NaN", "length", "column"],
)
def test_weights(weights, message):
    with pytest.raises(ValueError, match=message):
        problem(weights=weights)


def test_degree():
    with pytest.raises(ValueError, match="degree: must be at least 1, found 0: aff"):
        problem(degree=0)


def test_width():
    with pytest.raises(
        ValueError, match="support of every centre .*more centres or lar"
    ):
        problem(width=0.3)


def test_linear_algebra():
    with pytest.raises(
        ValueError, match="expected 'auto', 'sparse' or 'dense', found 'q"
    ):
        mr.solve(problem(), 1.0, linear_algebra="qr")


@pytest.mark.parametrize("folds", [1, 10])
def test_folds(folds):
    with pytest.raises(ValueError, match="folds: must lie between 2 and .* data, 9"):
        mr.cross_validate(INTERVAL, LINE, X, Z, folds=folds, centres=10)


def test_wrong_types():
    """In a process of its own: here the types are checked before manireg sees them."""
    program = """
import jax, numpy as np, manireg as mr
jax.config.update("jax_enable_x64", True)
x, box = np.linspace(0, 1, 9), mr.Box([0], [1])
for mistake in (
    lambda: mr.make_problem(box, box, x[:, None], x[:, None]),
    lambda: mr.make_problem((0, 1), mr.Euclidean(1), x, x[:, None]),
    lambda: mr.solve(None, 1.0, method="newton"),
):
    try:
        mistake()
    except ValueError as error:
        print(error)
"""
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert run.stdout.splitlines() == [
        "target: expected a manireg manifold, found Box.",
        "source: expected an Interval, a Circle, a Box, an Ambient, a manifold or another "
        "AbstractSource, found tuple.",
        "method: expected 'projected' or 'penalty', found 'newton'.",
    ]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: mr.Interval(1, 0),
            "Interval: the lower bound must be below the upper",
        ),
        (lambda: mr.Interval(0, np.inf), "Interval: bounds must be finite"),
        (
            lambda: mr.Box([0, 1], [1, 1]),
            "Box: the lower bound must be below the upper",
        ),
        (lambda: mr.Box([0, 1], [1]), "must have the same length, found 2 and 1"),
    ],
)
def test_bounds(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_float32():
    with (
        jax.enable_x64(False),
        pytest.raises(ValueError, match="manireg needs float64"),
    ):
        problem()
    with (
        jax.enable_x64(False),
        pytest.raises(ValueError, match='"jax_enable_x64", True'),
    ):
        mr.eells_energy(INTERVAL, SPHERE, lambda t: t)


def test_unbounded_source():
    with pytest.raises(ValueError, match="Euclidean is unbounded as a source"):
        mr.eells_energy(mr.Euclidean(2), SPHERE, lambda x: x)
    flat = np.stack([X, 0 * X], axis=1)
    with pytest.raises(ValueError, match="which is empty: all points agree in a coord"):
        problem(flat, Y, mr.Euclidean(2))


@pytest.fixture(scope="module")
def model():
    x = np.linspace(0, 1, 9)[:, None]
    return mr.fit(mr.Euclidean(1), LINE, x, x**2, 1e-3, centres=10)


@pytest.mark.parametrize(
    ("x", "message"),
    [
        (np.array([[5.0]]), "outside the support of every centre of the fitted map"),
        (np.array([[np.nan]]), "x: 1 of 1 points hold NaN or infinity"),
        (np.ones(2), r"x: expected shape \(k, 1\) for Euclidean, found \(2,\)"),
        (np.array(0.5), r"x: expected shape \(k, 1\) for Euclidean, found \(\)"),
        (np.array([["a"]]), "x: expected real numbers"),
    ],
    ids=["uncovered", "NaN", "shape", "scalar", "string"],
)
def test_prediction(model, x, message):
    with pytest.raises((ValueError, eqx.EquinoxRuntimeError), match=message):
        model(x)


def test_prediction_outside_a_bounded_source(model):
    interval = eqx.tree_at(lambda m: m.source, model, INTERVAL)
    with pytest.raises(ValueError, match="1 of 2 points lie outside the interval"):
        interval(np.array([0.5, 1.5]))


def test_newton_that_stops_early_raises_unless_told_not_to():
    bent = mr.make_problem(INTERVAL, SPHERE, X, np.roll(Y, 1, axis=1)[::-1], centres=10)
    options = dict(max_steps=1, starts=(1.0,))
    with pytest.raises(RuntimeError, match="did not converge for lam = 0.001") as error:
        mr.solve(bent, 1e-3, **options)
    for part in ("objective", "max_steps = 1)", "promised", "`throw=False`"):
        assert part in str(error.value)
    assert "root-find" not in str(error.value)
    traced = eqx.filter_jit(lambda p: mr.solve(p, 1e-3, **options).coefficients)
    with pytest.raises(eqx.EquinoxRuntimeError, match="fit: Newton did not converge"):
        traced(bent)
    model = mr.solve(bent, 1e-3, throw=False, **options)
    assert "maximum number of steps" in str(model.result)
    assert np.all(np.isfinite(model(X)))


class WrongDistance(mr.AbstractManifold):
    """The unit sphere with the chord for the distance."""

    dim: int = eqx.field(static=True, default=2)
    point_shape: tuple[int, ...] = eqx.field(static=True, default=(3,))

    @property
    def reach(self):
        return 1.0

    @property
    def injectivity_radius(self):
        return np.pi

    def project(self, p):
        return SPHERE.project(p)

    def tangent_projection(self, p, v):
        return SPHERE.tangent_projection(p, v)

    def second_fundamental_form(self, p, u, v):
        return SPHERE.second_fundamental_form(p, u, v)

    def squared_distance(self, p, q):
        return jnp.sum((p - q) ** 2, axis=-1)

    def exp(self, p, v):
        return SPHERE.exp(p, v)

    def log(self, p, q):
        return SPHERE.log(p, q)

    def random_points(self, key, n):
        return SPHERE.random_points(key, n)


def test_manifold_that_breaks_a_law():
    with pytest.raises(ValueError, match="squared_distance` breaks the law"):
        mr.check_manifold(WrongDistance(), jnp.asarray(Y))
