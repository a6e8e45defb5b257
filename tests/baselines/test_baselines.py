import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hard_constraint import hard_constraint
from regular_grid import grid_on, second_differences
from scipy.interpolate import make_smoothing_spline
from scipy.optimize import minimize

import manireg as mr
from manireg import baselines, manifolds

INTERVAL = mr.Interval(0, 1)
LINE = manifolds.Euclidean(1)
SPHERE = manifolds.Sphere(2)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture
def scalars(rng):
    x = np.sort(rng.uniform(size=20))
    return x, np.sin(6 * x) + 0.1 * rng.normal(size=20)


@pytest.fixture
def curve(rng):
    """A noisy curve on the sphere."""
    x = np.sort(rng.uniform(size=20))
    y = np.stack([np.cos(3 * x), np.sin(3 * x), np.sin(5 * x)], 1)
    y += 0.1 * rng.normal(size=y.shape)
    return x, y / np.linalg.norm(y, axis=1, keepdims=True)


def angle(p, q):
    return np.arccos(np.clip(np.sum(p * q, axis=-1), -1, 1))


# Projected thin plate


@pytest.mark.parametrize("lam", [1e-3, 1e-5])
def test_thin_plate_into_the_line_is_the_smoothing_spline(scalars, lam):
    x, y = scalars
    t = np.linspace(x[0], x[-1], 301)
    ours = baselines.projected_thin_plate(
        INTERVAL, LINE, x, y[:, None], lam, centres=30
    )
    theirs = make_smoothing_spline(x, y, lam=len(x) * lam)(t)
    np.testing.assert_allclose(ours(t)[:, 0], theirs, atol=3e-5)


def test_thin_plate_weights_are_those_of_scipy(scalars, rng):
    x, y = scalars
    w = rng.uniform(0.2, 3, size=len(x))
    ours = baselines.projected_thin_plate(
        INTERVAL, LINE, x, y[:, None], 1e-4, weights=w, centres=30
    )
    theirs = make_smoothing_spline(x, y, w, lam=w.sum() * 1e-4)(x)
    np.testing.assert_allclose(ours(x)[:, 0], theirs, atol=3e-5)


def test_thin_plate_is_projected(curve):
    x, y = curve
    model = baselines.projected_thin_plate(INTERVAL, SPHERE, x, y, 1e-4)
    t = np.linspace(0, 1, 50)
    ambient = np.asarray(model.ambient(t))
    expected = ambient / np.linalg.norm(ambient, axis=1, keepdims=True)
    np.testing.assert_allclose(model(t), expected, atol=1e-15)
    assert np.abs(np.linalg.norm(ambient, axis=1) - 1).max() > 1e-3


def test_thin_plate_scores_are_those_of_refits(curve, key):
    x, y = curve
    lams = [1e-6, 1e-4, 1e-2]
    model = baselines.projected_thin_plate(
        INTERVAL, SPHERE, x, y, lams=lams, folds=4, key=key, centres=30
    )
    fold_of = np.asarray(jax.random.permutation(key, 20)) % 4
    for fold in (0, 3):
        out = fold_of == fold
        refit = baselines.projected_thin_plate(
            INTERVAL, SPHERE, x[~out], y[~out], lams[1], centres=30
        )
        score = np.mean(angle(np.asarray(refit(x[out])), y[out]))
        np.testing.assert_allclose(model.scores[fold, 1], score, rtol=1e-6)
    best = np.argmin(np.mean(model.scores, axis=0))
    assert float(model.lam) == lams[best]


def test_thin_plate_and_eells_score_the_same_folds(scalars, key):
    """On flat targets both are one method: cross-validation must agree."""
    x, y = scalars
    lams = [1e-6, 1e-5, 1e-4, 1e-3]
    options = {"folds": 5, "key": key, "centres": 30}
    ours = baselines.projected_thin_plate(
        INTERVAL, LINE, x, y[:, None], lams=lams, **options
    )
    eells = mr.cross_validate(
        INTERVAL, LINE, x, y[:, None], lams, progress=False, **options
    )
    np.testing.assert_allclose(ours.scores, eells.scores, rtol=1e-5)


def test_default_grid_widens_past_its_edge(rng):
    """Data without noise want interpolation: less than the smallest lambda."""
    x = np.linspace(0, 1, 20)
    y = np.sin(3 * x)[:, None]
    model = baselines.projected_thin_plate(INTERVAL, LINE, x, y)
    default = mr.lambda_grid(mr.make_problem(INTERVAL, LINE, x, y))
    assert model.lams.shape == (model.scores.shape[1],) and len(model.lams) in (40, 60)
    assert float(model.lam) < float(default[0])
    assert np.all(np.diff(model.lams) > 0)
    span = np.log(default[-1] / default[0])
    assert np.log(default[0] / model.lams[0]) < 0.51 * span


# Nadaraya-Watson


def test_nadaraya_watson_in_the_plane_is_the_formula(rng):
    source, target = mr.Box([0, 0], [1, 1]), manifolds.Euclidean(2)
    x, y = rng.uniform(size=(15, 2)), rng.normal(size=(15, 2))
    w, t = rng.uniform(1, 2, size=15), rng.uniform(size=(8, 2))
    model = baselines.nadaraya_watson(source, target, x, y, 0.2, weights=w)
    squared = np.sum((t[:, None] - x) ** 2, axis=-1)
    kernel = w * np.exp(-squared / (2 * 0.2**2))
    expected = kernel @ y / kernel.sum(1, keepdims=True)
    np.testing.assert_allclose(model(t), expected, atol=1e-14)


def test_nadaraya_watson_far_from_all_data_takes_the_nearest():
    x, y = np.array([0.0, 0.1, 0.2]), np.array([[1.0], [2.0], [3.0]])
    model = baselines.nadaraya_watson(INTERVAL, LINE, x, y, 1e-3)
    np.testing.assert_allclose(model(np.array([1.0])), [[3.0]], atol=1e-14)


def test_nadaraya_watson_leaves_one_out(scalars):
    x, y = scalars
    grid = [0.01, 0.03, 0.1]
    model = baselines.nadaraya_watson(
        INTERVAL, LINE, x, y[:, None], bandwidths=grid, folds=len(x)
    )
    kernel = np.exp(-((x[:, None] - x) ** 2) / (2 * np.array(grid)[:, None, None] ** 2))
    kernel *= 1 - np.eye(len(x))
    errors = np.abs(kernel @ y / kernel.sum(-1) - y)
    np.testing.assert_allclose(np.mean(model.scores, axis=0), errors.mean(1), rtol=1e-9)
    assert float(model.bandwidth) == grid[np.argmin(errors.mean(1))]


def test_nadaraya_watson_on_the_sphere_is_a_frechet_mean(curve):
    x, y = curve
    model = baselines.nadaraya_watson(INTERVAL, SPHERE, x, y, 0.1)
    for t in (0.2, 0.7):
        kernel = np.exp(-((t - x) ** 2) / (2 * 0.1**2))

        def spread(q):
            return kernel @ angle(q / np.linalg.norm(q), y) ** 2

        q = minimize(spread, y[np.argmax(kernel)], tol=1e-12).x
        ours = np.asarray(model(np.array([t]))[0])
        np.testing.assert_allclose(ours, q / np.linalg.norm(q), atol=1e-6)
        assert spread(ours) <= spread(q) + 1e-14


def test_nadaraya_watson_measures_along_the_source(rng):
    circle = manifolds.Sphere(1)
    a, b, w = np.array([0.3, 2.8, 5.9]), np.array([0.1]), np.array([1.0, 2.0, 4.0])
    on_circle = lambda s: np.stack([np.cos(s), np.sin(s)], axis=1)
    model = baselines.nadaraya_watson(circle, LINE, on_circle(a), w[:, None], 0.8)
    gap = np.minimum(abs(a - b), 2 * np.pi - abs(a - b))
    kernel = np.exp(-(gap**2) / (2 * 0.8**2))
    expected = kernel @ w / kernel.sum()
    np.testing.assert_allclose(model(on_circle(b)), [[expected]], atol=1e-12)


def test_nadaraya_watson_chooses_a_sensible_bandwidth(curve):
    x, y = curve
    model = baselines.nadaraya_watson(INTERVAL, SPHERE, x, y)
    means = np.mean(model.scores, axis=0)
    assert means.min() < 0.9 * means[0] and means.min() < 0.3 * means[-1]
    assert 0.01 < float(model.bandwidth) < 0.3


def test_frechet_mean_finds_the_lowest_of_several_minima(rng):
    """On a circle the sum has a minimum between many pairs of points."""
    circle = manifolds.Sphere(1)
    s = np.linspace(0, 2 * np.pi, 200_001)
    for weights in ([1.0, 1.0, 1.1], [3.0, 1.0, 1.0], [1.0, 1.5, 1.4]):
        a = np.array([0.0, 2.2, 4.1])
        gap = np.abs(s[:, None] - a) % (2 * np.pi)
        spread = np.minimum(gap, 2 * np.pi - gap) ** 2 @ np.array(weights)
        best = s[np.argmin(spread)]
        points = jnp.stack([jnp.cos(a), jnp.sin(a)], axis=1)
        mean = baselines.frechet_mean(circle, points, jnp.array(weights))
        np.testing.assert_allclose(mean, [np.cos(best), np.sin(best)], atol=1e-4)


# Hard constraint


@pytest.mark.slow
def test_hard_constraint_and_eells_agree(curve):
    """Two discretisations and two solvers of one problem; second order in the step."""
    x, y = curve
    t = np.linspace(0, 1, 200)
    reference = mr.fit(INTERVAL, SPHERE, x, y, 1e-4, centres=60)
    models = [
        hard_constraint(INTERVAL, SPHERE, x, y, 1e-4, nodes=n) for n in (100, 200)
    ]
    gaps = [float(jnp.abs(model(t) - reference(t)).max()) for model in models]
    assert gaps[1] < 6e-5 and 3 < gaps[0] / gaps[1] < 5
    assert all(model.converged for model in models)
    energies = reference.energies
    np.testing.assert_allclose(models[1].eells, energies.eells, rtol=3e-4)
    np.testing.assert_allclose(models[1].loss, energies.loss, rtol=1e-3)


def test_hard_constraint_into_the_line_is_the_smoothing_spline(scalars):
    x, y = scalars
    model = hard_constraint(INTERVAL, LINE, x, y[:, None], 1e-3)
    theirs = make_smoothing_spline(x, y, lam=len(x) * 1e-3)(x)
    np.testing.assert_allclose(model(x)[:, 0], theirs, atol=2e-5)


@pytest.mark.slow
def test_hard_constraint_on_a_box(rng):
    """Against the thin plate; affine maps are exact."""
    source = mr.Box([0, 0], [1, 2])
    x = rng.uniform(size=(30, 2)) * [1, 2]
    noise = 0.1 * rng.normal(size=30)
    y = (np.sin(3 * x[:, 0]) * x[:, 1] + noise)[:, None]
    model = hard_constraint(source, LINE, x, y, 1e-3)
    plate = baselines.projected_thin_plate(source, LINE, x, y, 1e-3)
    t = rng.uniform(size=(100, 2)) * [1, 2]
    np.testing.assert_allclose(model(t), plate(t), atol=3e-3)
    affine = x @ np.array([1.0, -2.0]) + 0.5
    flat = hard_constraint(source, LINE, x, affine[:, None], 1e-3, nodes=12)
    assert flat.eells < 1e-16 and flat.loss < 1e-20


def test_second_differences_of_quadratics_are_exact():
    """S(xy) = 2 and S(x^2) = 4 per area; pure differences leave out half a cell at
    each end."""
    source = mr.Box([0, 0], [1, 2])
    grid = grid_on(source, 21)
    _, differences, weights = second_differences(grid)
    x, y = grid.points.T
    energy = lambda f: np.sum(weights * (differences @ f) ** 2)
    np.testing.assert_allclose(energy(x * y), 4, rtol=1e-12)
    np.testing.assert_allclose(energy(x**2), 8 * (1 - grid.steps[0]), rtol=1e-12)


@pytest.mark.slow
def test_hard_constraint_tends_to_geodesic_regression(curve):
    x, y = curve
    limit = baselines.geodesic_regression(INTERVAL, SPHERE, x, y)
    gaps = []
    for lam in (1.0, 10.0):
        model = hard_constraint(INTERVAL, SPHERE, x, y, lam, nodes=200)
        gaps.append(float(jnp.abs(model(x) - limit(x)).max()))
    assert gaps[1] < 1e-3 and 5 < gaps[0] / gaps[1] < 20  # O(1 / lambda)


# Geodesic regression


def test_geodesic_regression_in_space_is_least_squares(rng):
    source, target = mr.Box([0, 0], [1, 1]), manifolds.Euclidean(3)
    x, y = rng.uniform(size=(12, 2)), rng.normal(size=(12, 3))
    w = rng.uniform(1, 2, size=12)
    model = baselines.geodesic_regression(source, target, x, y, weights=w)
    design = np.concatenate([np.ones((12, 1)), x], axis=1)
    root = np.sqrt(w)[:, None]
    plane = np.linalg.lstsq(root * design, root * y)[0]
    np.testing.assert_allclose(model(x), design @ plane, atol=1e-7)


@pytest.mark.parametrize("speed", [0.5, 4.0, 15.0])
def test_geodesic_regression_recovers_great_circles(speed):
    x = np.linspace(0, 1, 20)
    y = np.stack([np.cos(speed * x), 0.6 * np.sin(speed * x), 0.8 * np.sin(speed * x)])
    model = baselines.geodesic_regression(INTERVAL, SPHERE, x, y.T)
    assert model.loss < 1e-20
    np.testing.assert_allclose(jnp.linalg.norm(model.velocities), speed, rtol=1e-9)
    np.testing.assert_allclose(model(x), y.T, atol=1e-9)


def test_geodesic_regression_of_noisy_data_is_a_minimum(curve):
    x, y = curve
    model = baselines.geodesic_regression(INTERVAL, SPHERE, x, y)
    loss = np.mean(angle(np.asarray(model(x)), y) ** 2)
    np.testing.assert_allclose(model.loss, loss, rtol=1e-9)

    def of(parameters):
        p, v = np.split(parameters, 2)
        p = p / np.linalg.norm(p)
        v = v - v @ p * p
        along = (x - x.mean())[:, None] * np.linalg.norm(v)
        predicted = np.cos(along) * p + np.sin(along) * v / np.linalg.norm(v)
        return np.mean(angle(predicted, y) ** 2)

    start = np.concatenate([model.point, model.velocities[0]])
    np.testing.assert_allclose(of(start), loss, rtol=1e-9)
    assert minimize(of, start, tol=1e-14).fun > loss - 1e-10
    assert minimize(of, start + 0.1, tol=1e-14).fun > loss - 1e-10


@pytest.mark.slow
def test_geodesic_regression_of_rotations(key):
    rotations = manifolds.SpecialOrthogonal(3)
    x = np.linspace(0, 1, 30)
    p = rotations.random_points(key, 1)[0]
    v = rotations.tangent_projection(p, 3 * jax.random.normal(key, (3, 3)))
    y = rotations.exp(
        jnp.broadcast_to(p, (30, 3, 3)), jnp.asarray(x)[:, None, None] * v
    )
    model = baselines.geodesic_regression(INTERVAL, rotations, x, y)
    assert model.loss < 1e-20
    np.testing.assert_allclose(model(x), y, atol=1e-8)


@pytest.mark.slow
def test_rank_one_geodesic_regression(rng):
    source = mr.Box([0, 0], [1, 1])
    x = rng.uniform(size=(30, 2))
    s = x @ [2.0, -1.0]
    y = np.stack([np.cos(s), np.sin(s), 0 * s], axis=1)
    model = baselines.geodesic_regression(source, SPHERE, x, y, rank_one=True)
    assert model.loss < 1e-20
    assert mr.eells_energy(source, SPHERE, lambda x: model(x[None])[0], 256) < 1e-12
    bent = y + 0.2 * rng.normal(size=y.shape)
    bent /= np.linalg.norm(bent, axis=1, keepdims=True)
    narrow = baselines.geodesic_regression(source, SPHERE, x, bent, rank_one=True)
    singular = np.linalg.svd(narrow.velocities)[1]
    assert singular[1] < 1e-12 * singular[0]


# Bad input


@pytest.mark.parametrize(
    "call, message",
    [
        (
            lambda x, y: baselines.nadaraya_watson(INTERVAL, SPHERE, x, y, -1.0),
            "bandwidth: must be positive",
        ),
        (
            lambda x, y: baselines.nadaraya_watson(
                INTERVAL, SPHERE, x, y, bandwidths=[np.nan]
            ),
            "bandwidths: must be positive",
        ),
        (
            lambda x, y: baselines.nadaraya_watson(
                INTERVAL, SPHERE, x, y, 0.1, bandwidths=[1]
            ),
            "not both",
        ),
        (
            lambda x, y: baselines.nadaraya_watson(INTERVAL, SPHERE, x, y, folds=21),
            "folds: must lie between 2 and the number of data, 20",
        ),
        (
            lambda x, y: baselines.nadaraya_watson(INTERVAL, SPHERE, x, 2 * y),
            "y: 20 of 20 points lie off Sphere",
        ),
        (
            lambda x, y: baselines.projected_thin_plate(INTERVAL, SPHERE, x, y, 0.0),
            "lam: lambda must be positive",
        ),
        (
            lambda x, y: baselines.projected_thin_plate(
                INTERVAL, SPHERE, x, y, 0.1, lams=[1]
            ),
            "lam, lams: give a value",
        ),
        (
            lambda x, y: baselines.projected_thin_plate(
                INTERVAL, SPHERE, x, y, lams=[1, -1]
            ),
            "lams: lambda must be positive",
        ),
        (
            lambda x, y: baselines.projected_thin_plate(INTERVAL, SPHERE, x[1:], y),
            "y: expected 19 points",
        ),
        (
            lambda x, y: baselines.geodesic_regression(SPHERE, SPHERE, y, y),
            "geodesic_regression is defined for Interval, Box, Euclidean",
        ),
        (
            lambda x, y: baselines.geodesic_regression(INTERVAL, SPHERE, x, np.nan * y),
            "y: 20 of 20 points hold NaN",
        ),
    ],
)
def test_bad_input(curve, call, message):
    with pytest.raises(ValueError, match=message):
        call(*curve)


@pytest.mark.parametrize(
    "build",
    [
        lambda x, y: baselines.projected_thin_plate(INTERVAL, SPHERE, x, y, 1e-3),
        lambda x, y: baselines.nadaraya_watson(INTERVAL, SPHERE, x, y, 0.1),
        lambda x, y: baselines.geodesic_regression(INTERVAL, SPHERE, x, y),
    ],
)
def test_models_check_new_inputs_and_stay_on_the_target(curve, build):
    model = build(*curve)
    values = model(np.linspace(0, 1, 7))
    np.testing.assert_allclose(jnp.linalg.norm(values, axis=1), 1, atol=1e-14)
    np.testing.assert_allclose(
        eqx.filter_jit(model)(jnp.linspace(0, 1, 7)), values, atol=1e-12
    )
    with pytest.raises(ValueError, match="x: 1 of 2 points lie outside the interval"):
        model(np.array([0.5, 1.5]))
