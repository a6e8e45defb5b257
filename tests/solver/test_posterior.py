"""Posteriors of maps into R^1 and R^2 against dense smoothing splines, on spheres against
what they say of each other."""

# what is None elsewhere is known here
# pyright: reportOptionalMemberAccess=false, reportArgumentType=false
# pyright: reportOptionalOperand=false, reportCallIssue=false
# pyright: reportAttributeAccessIssue=false

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from curves import TIMES, curve_problem, sphere_data
from dense_splines import CENTRES, Spline, noisy_wave
from scipy import stats
from scipy.linalg import expm

import manireg as mr
from manireg._solver.at_minimum import _along_lambda, at_minimum
from manireg._solver.regions import Region, conformal_radius, quantile_radius
from manireg.manifolds._defaults.frames import tangent_frames

X, Y, SOURCE = noisy_wave()
K, LAM, LINE, SPHERE = len(X), 1e-5, mr.Euclidean(1), mr.Sphere(2)
RNG = np.random.default_rng(1)
SIGMA = RNG.uniform(0.1, 0.4, K)
NEW = np.linspace(X[3] + 0.003, X[-4] - 0.002, 9)


def on_line(y=Y, lam=LAM, **options):
    y = np.asarray(y)[:, None]
    return mr.solve(
        mr.make_problem(SOURCE, LINE, X, y, centres=CENTRES, **options), lam
    )


def deviations(covariance):
    return np.sqrt(covariance[:, 0, 0])


@pytest.fixture(scope="module")
def line():
    return on_line()


@pytest.fixture(scope="module")
def curve():
    """On S^2, with a few degrees of noise."""
    return mr.solve(curve_problem(SPHERE, sphere_data(), sigma=0.05), 1e-4)


# Smoothing splines


def test_standard_errors(line):
    dense = Spline(X, np.ones(K), K * LAM)
    post = line.posterior("known")
    np.testing.assert_allclose(post.spread.edf, dense.edf, rtol=1e-6)
    rss, penalty = dense.quadratic(Y)
    np.testing.assert_allclose(post.spread.rss, rss, rtol=1e-6)
    np.testing.assert_allclose(post.spread.penalty, penalty, rtol=1e-5)
    variance = rss / (K - dense.edf)
    np.testing.assert_allclose(post.spread.found, variance, rtol=1e-6)
    covariance, frames = post.covariance(X)
    np.testing.assert_allclose(np.abs(frames), 1)
    expected = np.sqrt(variance * np.diag(dense.covariance))
    np.testing.assert_allclose(deviations(covariance), expected, rtol=1e-5)
    covariance, _ = post.sampling_covariance(X)
    expected = variance * np.sum(dense.smoother**2, axis=1)
    np.testing.assert_allclose(covariance[:, 0, 0], expected, rtol=1e-5)


def test_between_the_data(line):
    """There the prior adds to what interpolation would say."""
    both = np.sort(np.append(X, NEW))
    dense = Spline(both, np.isin(both, X).astype(float), K * LAM)
    post = line.posterior("known")
    expected = np.diag(dense.covariance)[np.isin(both, NEW)]
    found = post.covariance(NEW)[0][:, 0, 0] / post.spread.found
    np.testing.assert_allclose(found, expected, rtol=1e-3)


@pytest.mark.parametrize("name", ["weights", "sigma"])
def test_generalised_least_squares(name):
    q = SIGMA**-2.0
    model = on_line(**{name: q if name == "weights" else SIGMA})
    dense = Spline(X, q, K * LAM * np.mean(q))
    np.testing.assert_allclose(model(X)[:, 0], dense.fitted(Y), rtol=0, atol=1e-6)
    post = model.posterior("known")
    np.testing.assert_allclose(post.spread.edf, dense.edf, rtol=1e-6)
    phi = dense.quadratic(Y)[0] / (K - dense.edf)
    variance = np.diag(dense.covariance)
    if name == "weights":  # of which only ratios count
        assert post.spread.phi is None
        np.testing.assert_allclose(post.spread.found, phi / np.mean(q), rtol=1e-6)
        variance = phi * variance
    else:
        np.testing.assert_allclose(post.spread.phi, phi, rtol=1e-6)
    found = deviations(post.covariance(X)[0])
    np.testing.assert_allclose(found, np.sqrt(variance), rtol=1e-5)


@pytest.mark.parametrize("lacking", [0, 13])
def test_precisions_that_couple_two_splines(lacking):
    """Of some data nothing is known along a direction, in which they are far off."""
    roots = RNG.normal(size=(K, 2, 2)) + 2 * np.eye(2)
    roots[3 * np.arange(lacking), :, 1] = 0.0
    P = roots @ np.swapaxes(roots, 1, 2)
    y = np.stack([Y, np.cos(4 * X) + 0.2 * RNG.normal(size=K)], axis=1)
    some = roots[3 * np.arange(lacking), :, 0]
    y[3 * np.arange(lacking)] += 100 * np.stack([-some[:, 1], some[:, 0]], axis=1)
    problem = mr.make_problem(
        SOURCE, mr.Euclidean(2), X, y, precision=P, centres=CENTRES
    )
    model = mr.solve(problem, LAM)
    mean = np.mean(np.trace(P, axis1=1, axis2=2)) / 2
    dense = Spline(X, P, K * LAM * mean)
    np.testing.assert_allclose(model(X), dense.fitted(y).reshape(K, 2), atol=1e-6)
    post = model.posterior("known")
    covariance, U = post.covariance(X)
    found = U @ covariance @ np.swapaxes(U, 1, 2)
    blocks = dense.covariance.reshape(K, 2, K, 2)
    expected = np.stack([blocks[i, :, i] for i in range(K)])
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
    np.testing.assert_allclose(post.spread.edf, dense.edf, rtol=1e-6)
    assert post.spread.dof == 2 * K - lacking


def test_velocity_of_a_line(line):
    """Differences of the dense process, whose derivative is a Wiener process: the error
    is linear in the step; what is lost between the centres (a Wiener process is rough)
    is 1 %."""
    at = NEW[1:-1:2]

    def variance(step):
        around = np.sort(np.concatenate([X, at - step, at + step]))
        dense = Spline(around, np.isin(around, X).astype(float), K * LAM)
        i, j = (np.searchsorted(around, at + s) for s in (-step, step))
        C = dense.covariance
        return (C[i, i] + C[j, j] - 2 * C[i, j]) / (2 * step) ** 2

    expected = 2 * variance(2e-4) - variance(4e-4)
    post = line.posterior("known")
    estimate = post.velocity(at)
    np.testing.assert_allclose(estimate.value, line.velocity(at), rtol=1e-12)
    found = estimate.covariance[:, 0, 0] / post.spread.found
    np.testing.assert_allclose(found, expected, rtol=0.02)


# Lambda as an estimate


def test_lambda_has_an_error(line):
    """Of rank one, along the derivative of the map in log lambda."""
    known = line.posterior("known").covariance(NEW)[0]
    wider = line.posterior().covariance(NEW)[0]
    step = 1e-3
    up, down = (on_line(lam=LAM * np.exp(s))(NEW) for s in (step, -step))
    slope = np.asarray(up - down)[:, 0] / (2 * step)
    added = (wider - known)[:, 0, 0]
    variance = np.sum(added * slope**2) / np.sum(slope**4)
    scale = variance * np.max(slope**2)
    np.testing.assert_allclose(added, variance * slope**2, atol=1e-4 * scale)

    sigma2 = at_minimum(line).spread.variance

    def deviance(log):
        q = np.full(K, 1 / sigma2)
        return Spline(X, q, K * LAM * np.exp(log) / sigma2).deviance(Y)

    h = 0.05
    bend = (deviance(h) - 2 * deviance(0.0) + deviance(-h)) / h**2
    np.testing.assert_allclose(variance, 2 / bend, rtol=0.1)


def test_traces_by_random_signs(line):
    dense = Spline(X, np.ones(K), K * LAM)
    found = at_minimum(line)
    parts = found.given, found.lam, found.w, found.hessian, found.solvers
    trace, square = _along_lambda(*parts)[2:]
    assert float(trace) == pytest.approx(dense.edf, rel=0.1)
    assert float(square) == pytest.approx(np.sum(dense.smoother**2), rel=0.1)


@pytest.fixture(scope="module")
def straight():
    """A line with noise, whose likelihood leaves open how large lambda is."""
    y = X + 0.1 * np.random.default_rng(3).normal(size=K)
    return y, on_line(y, lam=30.0)


def test_mixture_over_lambdas(straight):
    """Shares as a dense spline's profile likelihood and the prior say, moments about the
    fit."""
    y, model = straight
    post = model.posterior()
    parts = post.mixture.parts
    assert len(model.posterior("linear").mixture.parts) == 1 and len(parts) > 5
    lams = np.array([float(part.information.lam) for part in parts])
    steps = np.diff(np.log(lams))
    np.testing.assert_allclose(steps, steps[0])
    splines = [Spline(X, np.ones(K), K * lam) for lam in lams]
    dense = Spline(X, np.ones(K), K * 30.0)
    moments, deviances = [], []
    for lam, spline in zip(lams, splines, strict=True):
        rss, penalty = spline.quadratic(y)
        best = (rss + penalty) / (K - 2)
        profile = Spline(X, np.full(K, 1 / best), K * lam / best)
        deviances.append(profile.deviance(y))
        shift = spline.fitted(y) - dense.fitted(y)
        variance = rss / (K - spline.edf)
        moments.append(variance * np.diag(spline.covariance) + shift**2)
    expected = np.exp(-0.5 * (np.array(deviances) - min(deviances))) * lams**-0.25
    assert splines[-1].edf - 2 < 0.1 < splines[-2].edf - 2
    expected[-1] /= 1 - np.exp(-0.25 * steps[0])  # all larger ones
    shares = np.array([part.share for part in parts])
    assert np.sum(shares) == pytest.approx(1)
    np.testing.assert_allclose(shares, expected / np.sum(expected), rtol=0.05)
    covariance = post.covariance(X)[0][:, 0, 0]
    # the basis is not fine enough for the least lambda
    np.testing.assert_allclose(covariance, shares @ np.array(moments), rtol=1e-2)

    known = model.posterior("known").covariance(X)[0][:, 0, 0]
    assert np.mean(covariance) > 1.5 * np.mean(known)


def test_unknown_smoothing(line, unchecked):
    with pytest.raises(ValueError, match="smoothing: expected one of 'auto', 'known'"):
        line.posterior("exact")  # type: ignore[arg-type]


def test_draws_from_the_mixture(straight):
    """Their second moments about the fit."""
    _, model = straight
    post = model.posterior()
    maps = post.sample(jax.random.key(0), 2000)
    gaps = np.stack([np.asarray(m(X[::5]) - model(X[::5]))[:, 0] for m in maps])
    expected = post.covariance(X[::5])[0][:, 0, 0]
    np.testing.assert_allclose(np.mean(gaps**2, axis=0), expected, rtol=0.15)
    assert post.summary().rows() == model.summary().rows()


# Draws


def test_draws_scatter_as_the_covariance_says(curve):
    post = curve.posterior("known")
    at = TIMES[3:-3:6]
    maps = post.sample(jax.random.key(0), 400)
    assert len(maps) == 400 and maps[0].problem is None
    values = np.stack([np.asarray(m(at)) for m in maps])
    covariance, U = post.covariance(at)
    centre = np.asarray(curve(at))
    logs = jax.vmap(SPHERE.log, (None, 0))(jnp.asarray(centre), jnp.asarray(values))
    z = np.einsum("qtn,mqt->qmn", U, logs)
    z = z - z.mean(axis=1, keepdims=True)
    empirical = np.swapaxes(z, 1, 2) @ z / (len(maps) - 1)
    axes = [np.sqrt(np.linalg.eigvalsh(c)) for c in (empirical, covariance)]
    assert np.median(axes[0] / axes[1]) == pytest.approx(1, abs=0.1)
    assert np.all(np.abs(np.log(axes[0] / axes[1])) < 0.3)

    moving = post.velocity(at)
    np.testing.assert_allclose(moving.value, curve.velocity(at), rtol=1e-9, atol=1e-12)
    v = np.stack([np.asarray(m.velocity(at)) for m in maps])
    v = np.einsum("qtn,mqt->qmn", U, v)
    v = v - v.mean(axis=1, keepdims=True)
    empirical = np.swapaxes(v, 1, 2) @ v / (len(maps) - 1)
    pairs = zip(empirical, moving.covariance, strict=True)
    ratio = [np.sqrt(np.trace(a) / np.trace(b)) for a, b in pairs]
    assert np.median(ratio) == pytest.approx(1, abs=0.1)


# Regions


def hand_made(covariance, centre, level=0.95):
    centre = np.asarray(centre, float)[None]
    frames = tangent_frames(SPHERE, centre)
    radius, covariance = quantile_radius(level, 2), np.asarray(covariance)[None]
    return Region(SPHERE, jnp.asarray(centre), covariance, frames, radius, level)


def east_and_north(p):
    east = np.cross([0, 0, 1.0], p)
    east /= np.linalg.norm(east)
    return np.stack([east, np.cross(p, east)], axis=1)


def test_region_by_hand():
    p = np.array([0.6, 0.0, 0.8])
    around = hand_made(0.1**2 * np.eye(2), p)
    assert around.radius == pytest.approx(2.4477, abs=1e-4)
    np.testing.assert_allclose(around.theta95, np.degrees(0.24477), rtol=1e-4)
    for azimuth in (30.0, 155.0):
        a = np.radians(azimuth)
        geographic = east_and_north(p)
        turn = np.array([[np.sin(a), np.cos(a)], [np.cos(a), -np.sin(a)]])
        ambient = geographic @ turn @ np.diag([0.04, 0.01]) @ turn.T @ geographic.T
        U = tangent_frames(SPHERE, p[None])[0]
        region = hand_made(U.T @ ambient @ U, p)
        np.testing.assert_allclose(region.azimuth, azimuth)
        semi_axes = region.radius * np.array([[0.1, 0.2]])
        np.testing.assert_allclose(region.semi_axes, semi_axes, rtol=1e-12)
        longest = np.abs(region.directions[0, :, 1] @ geographic @ turn)
        np.testing.assert_allclose(longest, [1, 0], atol=1e-12)
        theta = np.degrees(np.sqrt(semi_axes.prod()))
        np.testing.assert_allclose(region.theta95, theta)


def test_contains_up_to_the_rim(curve):
    at = TIMES[::8]
    post = curve.posterior("known")
    region = post.region(at, 0.8)
    angle = 0.7 + np.arange(len(at))
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    root = np.linalg.cholesky(region.covariance)
    rim = np.einsum("qtn,qnm,qm->qt", region.frame, root, circle)
    rim *= np.sqrt(stats.chi2.ppf(0.8, 2))
    sent = lambda r: SPHERE.exp(region.centre, jnp.asarray(r * rim))
    assert np.all(region.contains(sent(0.999)))
    assert not np.any(region.contains(sent(1.001)))
    outline = region.outline(13)
    assert outline.shape == (len(at), 13, 3)
    np.testing.assert_allclose(outline[:, 0], outline[:, -1], atol=1e-12)
    logs = jax.vmap(SPHERE.log, (None, 1), 1)(region.centre, jnp.asarray(outline))
    z = np.einsum("qtn,qmt->qmn", region.frame, logs)
    lengths = np.einsum("qmn,qnp,qmp->qm", z, np.linalg.inv(region.covariance), z)
    np.testing.assert_allclose(lengths, region.radius**2, rtol=1e-6)
    with pytest.raises(ValueError, match="level: must lie between 0 and 1, found 1.5"):
        post.region(at, 1.5)


def test_band(curve):
    """Wider than at one point, but less than were all points independent."""
    post = curve.posterior("known")
    at = TIMES[::2]
    band, point = post.region(at, simultaneous=True), post.region(at)
    bonferroni = np.sqrt(stats.chi2.isf(0.05 / len(at), 2))
    assert 1.05 * point.radius < band.radius < bonferroni
    assert point.radius == pytest.approx(np.sqrt(stats.chi2.ppf(0.95, 2)))
    with pytest.raises(ValueError, match="`new` data are regions one by one"):
        post.region(at, simultaneous=True, new=True)


def test_new_data(line):
    """As many of the data, and one more, lie within the radius in the fits without
    them."""
    post = line.posterior("known")
    dense = Spline(X, np.ones(K), K * LAM)
    own, variance = np.diag(dense.smoother), post.spread.found
    r = np.abs(Y - dense.fitted(Y)) / np.sqrt(variance * (1 - own))
    for level in (0.5, 0.8, 0.95):
        region = post.region(NEW, level, new=True)
        rank = int(np.ceil((K + 1) * level))
        assert region.radius == pytest.approx(np.sort(r)[rank - 1], rel=1e-5)
        path = post.covariance(NEW)[0]
        np.testing.assert_allclose(region.covariance, path + variance)
    beyond = post.region(NEW, 0.99, new=0.3)
    assert beyond.radius == pytest.approx(stats.norm.isf(0.005))
    np.testing.assert_allclose(beyond.covariance, path + 0.3**2)
    assert conformal_radius(0.5, np.array([3.0, 1.0, 2.0]), 9.0) == 2.0
    assert conformal_radius(0.9, np.array([3.0, 1.0, 2.0]), 9.0) == 9.0


# Motions


def test_sphere_motion(curve):
    at = TIMES[5::9]
    post = curve.posterior()
    motion, moving = post.sphere_motion(at), post.velocity(at)
    expected = mr.sphere_motion(curve(at), curve.velocity(at))
    np.testing.assert_allclose(motion.speed, expected.speed, rtol=1e-10)
    np.testing.assert_allclose(motion.azimuth, expected.azimuth, rtol=1e-10)
    np.testing.assert_allclose(
        motion.euler_pole.centre, expected.euler_pole, atol=1e-10
    )
    # the part of the velocity along itself
    along = np.einsum("qtn,qt->qn", moving.frame, moving.value)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    variance = np.einsum("qn,qnm,qm->q", along, moving.covariance, along)
    np.testing.assert_allclose(motion.speed_deviation, np.sqrt(variance), rtol=1e-8)
    with pytest.raises(ValueError, match="angular_velocity: only of maps into Special"):
        post.angular_velocity(at)


@pytest.mark.slow
def test_angular_velocity():
    """About axes of the body: those of the space, turned back with the map."""
    turn = np.cross(sphere_data(), [0, 0, 1.0])
    generators = np.swapaxes(np.cross(np.eye(3), turn[:, None]), 1, 2)
    y = np.stack([expm(g) for g in generators])
    model = mr.solve(curve_problem(mr.SpecialOrthogonal(3), y), 1e-3)
    at = TIMES[5::20]
    post = model.posterior("known")
    space, body = (post.angular_velocity(at, axes) for axes in ("space", "body"))
    R = np.asarray(model(at))
    back = np.swapaxes(R, 1, 2)
    np.testing.assert_allclose(body.value, np.einsum("qab,qb->qa", back, space.value))
    expected = mr.angular_velocity(R, model.velocity(at))
    np.testing.assert_allclose(space.value, expected, atol=1e-10)
    # R^T omega moves with R, too
    maps = post.sample(jax.random.key(1), 200)
    for axes, estimate in (("space", space), ("body", body)):
        drawn = [
            np.asarray(mr.angular_velocity(m(at), m.velocity(at), axes)) for m in maps
        ]
        scatter = np.std(np.stack(drawn), axis=0)
        deviation = np.sqrt(np.diagonal(estimate.covariance, axis1=1, axis2=2))
        assert np.median(scatter / deviation) == pytest.approx(1, abs=0.1)
    with pytest.raises(ValueError, match='axes: expected "space" or "body"'):
        post.angular_velocity(at, "mind")


# Surfaces


@pytest.mark.slow
def test_surface():
    """Sparse covariances against the inverse of the whole Hessian."""
    x = SPHERE.random_points(jax.random.key(0), 60)
    noise = 0.05 * np.random.default_rng(0).normal(size=(60, 3))
    y = SPHERE.project(x + jnp.asarray(noise))
    model = mr.solve(mr.make_problem(SPHERE, SPHERE, x, y, centres=60), 1e-3)
    post = model.posterior("known")
    at = np.asarray(SPHERE.random_points(jax.random.key(1), 5))
    covariance, U = post.covariance(at)
    found = at_minimum(model)
    H = np.asarray(found.hessian.as_matrix())
    H = H + 1e-12 * np.diag(np.abs(np.diag(H)))
    w = jnp.asarray(model.coefficients)

    def value(w, i):
        moved = eqx.tree_at(lambda m: m.coefficients, model, w)
        return jnp.asarray(U[i].T) @ moved(at[i])

    for i in range(len(at)):
        J = np.asarray(jax.jacfwd(value)(w, i)).reshape(2, -1)
        expected = post.scale * J @ np.linalg.solve(H, J.T)
        np.testing.assert_allclose(covariance[i], expected, rtol=1e-5, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["line", "curve"])
def test_bootstrap(name, request):
    model = request.getfixturevalue(name)
    at = NEW if name == "line" else TIMES[3:-3:6]
    maps = mr.bootstrap(model, jax.random.key(0), 200)
    covariance, U = model.posterior().sampling_covariance(at)
    values = np.stack([np.asarray(m(at)) for m in maps])
    z = np.einsum("qtn,mqt->qmn", U, values - values.mean(axis=0))
    empirical = np.swapaxes(z, 1, 2) @ z / (len(maps) - 1)
    axes = [np.sqrt(np.linalg.eigvalsh(c)) for c in (empirical, covariance)]
    assert np.median(axes[0] / axes[1]) == pytest.approx(1, abs=0.1)


# What is refused


def test_map_without_its_problem(line):
    alone = dataclasses.replace(line, problem=None)
    for ask in (alone.posterior, alone.summary, lambda: alone.data_weights):
        with pytest.raises(ValueError, match="This map has left its problem behind"):
            ask()
    assert dataclasses.replace(alone, problem=line.problem).posterior() is not None


@pytest.mark.slow
def test_fits_under_jit_have_no_problem(line):
    problem = line.problem
    fit = eqx.filter_jit(
        lambda y: mr.solve(eqx.tree_at(lambda p: p.y, problem, y), LAM)
    )
    model = fit(problem.y)
    assert model.problem is None
    np.testing.assert_allclose(model(NEW), line(NEW), atol=1e-10)
    with pytest.raises(ValueError, match="fitted under `jit`"):
        model.posterior()
