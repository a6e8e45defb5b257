"""What users say of the precision of data: the quadratic forms it becomes, and what is
refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from clouds import torus_cloud
from helpers import MANIFOLDS
from scipy import stats

import manireg as mr
from manireg._sources.noise import check_noise
from manireg.manifolds._defaults.frames import orthonormal_axes, tangent_frames

K = 5
SPHERE, ROTATIONS, PLANE = mr.Sphere(2), mr.SpecialOrthogonal(3), mr.Euclidean(2)


def points_on(target, k=K):
    points = target.random_points(jax.random.key(1), k)
    return np.asarray(points).reshape(k, -1)


def definite(k, n, rng):
    roots = rng.normal(size=(k, n, n))
    return roots @ np.swapaxes(roots, 1, 2)


def rotated_frames(target, y, rng):
    frames = tangent_frames(target, y)
    return frames @ np.linalg.qr(rng.normal(size=(len(y), target.dim, target.dim)))[0]


def forms(noise, v):
    """Of one vector (k, t) for each datum."""
    along = np.einsum("ktn,kt->kn", noise.axes, v)
    return np.sum(noise.precisions * along**2, axis=1)


def test_nothing():
    assert check_noise(SPHERE, points_on(SPHERE)) is None


@pytest.mark.parametrize("kind", [list, np.array, pd.Series, jnp.asarray])
def test_sigma(kind):
    y, sigma = points_on(SPHERE), [0.1, 0.2, 0.5, 1.0, 2.0]
    noise = check_noise(SPHERE, y, kind(sigma))
    assert noise is not None and noise.axes is None
    np.testing.assert_allclose(noise.precisions, [100.0, 25.0, 4.0, 1.0, 0.25])
    one = check_noise(SPHERE, y, 0.2)
    assert one is not None
    np.testing.assert_allclose(one.precisions, np.full(K, 25.0))


@pytest.mark.parametrize("name", MANIFOLDS)
def test_precision(name):
    """The quadratic form of tangent vectors, however it is given."""
    target, rng = MANIFOLDS[name], np.random.default_rng(0)
    y, n, shape = points_on(target), target.dim, target.point_shape
    frames, within = rotated_frames(target, y, rng), definite(K, n, rng)
    ambient = definite(K, y.shape[1], rng)
    coordinates = rng.normal(size=(K, n))
    v = np.einsum("ktn,kn->kt", frames, coordinates)
    residual = orthonormal_axes(target, y, v[:, :, None])[:, :, 0]
    given = [
        (ambient, None, np.einsum("kt,ktu,ku->k", v, ambient, v)),
        (ambient.reshape(K, *shape, *shape), None, None),
        (within, frames, np.einsum("kn,knm,km->k", coordinates, within, coordinates)),
        (within, frames.reshape(K, *shape, n), None),
    ]
    expected = np.zeros(K)
    for precision, of_frames, form in given:
        noise = check_noise(target, y, precision=precision, frames=of_frames)
        assert noise is not None and noise.axes is not None
        expected = expected if form is None else form
        np.testing.assert_allclose(forms(noise, residual), expected, rtol=1e-10)
        axes = np.asarray(noise.axes)
        products = np.swapaxes(axes, 1, 2) @ axes
        np.testing.assert_allclose(products, np.tile(np.eye(n), (K, 1, 1)), atol=1e-12)
        p, vectors = jnp.asarray(y), jnp.asarray(np.moveaxis(axes, 2, 0))
        p, vectors = p.reshape(K, *shape), vectors.reshape(n, K, *shape)
        vectors = target.from_orthonormal(p, vectors)
        inside = target.tangent_projection(p, vectors)
        np.testing.assert_allclose(inside, vectors, rtol=1e-9, atol=1e-12)


def test_plane():
    """Ambient coordinates are those of the identity's frames."""
    y, P = points_on(PLANE), definite(K, 2, np.random.default_rng(0))
    plain = check_noise(PLANE, y, precision=P)
    framed = check_noise(PLANE, y, precision=P, frames=np.tile(np.eye(2), (K, 1, 1)))
    for noise in (plain, framed):
        assert noise is not None and noise.axes is not None
        axes = np.asarray(noise.axes)
        again = axes * np.asarray(noise.precisions)[:, None] @ np.swapaxes(axes, 1, 2)
        np.testing.assert_allclose(again, P, rtol=1e-12)


def test_frames_of_few_digits_become_orthonormal():
    rng = np.random.default_rng(0)
    y, P = points_on(SPHERE), definite(K, 2, rng)
    frames = rotated_frames(SPHERE, y, rng)
    noise = check_noise(SPHERE, y, precision=P, frames=frames.round(7))
    assert noise is not None and noise.axes is not None
    axes = np.asarray(noise.axes)
    products = np.swapaxes(axes, 1, 2) @ axes
    np.testing.assert_allclose(products, np.tile(np.eye(2), (K, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.einsum("ktn,kt->kn", axes, y), 0, atol=1e-14)
    exact = check_noise(SPHERE, y, precision=P, frames=frames)
    assert exact is not None
    np.testing.assert_allclose(noise.precisions, exact.precisions, rtol=1e-12)


def test_nothing_known_along_an_axis():
    """The distance to a great circle is measured, for one."""
    y = points_on(SPHERE)
    across = np.cross(y, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    noise = check_noise(SPHERE, y, precision=9 * across[:, :, None] * across[:, None])
    assert noise is not None and noise.axes is not None
    precisions = np.asarray(noise.precisions)
    assert np.all(precisions[:, 0] == 0)  # rounding would count as a degree of freedom
    np.testing.assert_allclose(precisions, np.tile([0.0, 9.0], (K, 1)), atol=1e-14)
    cosines = np.einsum("kt,kt->k", noise.axes[:, :, 1], across)
    np.testing.assert_allclose(np.abs(cosines), 1)


def test_rounding_is_forgiven():
    y = points_on(PLANE)
    P = np.tile([[1.0, 1.0], [1.0, 1.0 - 1e-12]], (K, 1, 1))  # eigenvalue -5e-13
    P[:, 0, 1] += 1e-10
    noise = check_noise(PLANE, y, precision=P)
    assert noise is not None and np.all(np.asarray(noise.precisions) >= 0)
    np.testing.assert_allclose(noise.precisions, np.tile([0.0, 2.0], (K, 1)), atol=2e-9)


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_units(unit):
    rng, big = np.random.default_rng(0), mr.Sphere(2, unit)
    y = points_on(SPHERE)
    P, sigma = definite(K, 3, rng), rng.uniform(0.1, 1, K)
    frames = rotated_frames(SPHERE, y, rng)
    for given in (
        lambda u: {"sigma": u * sigma},
        lambda u: {"precision": P / u**2},
        lambda u: {"precision": P[:, :2, :2] / u**2, "frames": frames},
    ):
        one = check_noise(SPHERE, y, **given(1.0))
        other = check_noise(big, unit * y, **given(unit))
        assert one is not None and other is not None
        np.testing.assert_allclose(unit**2 * other.precisions, one.precisions)
        if one.axes is not None and other.axes is not None:
            v = np.einsum("ktn,kn->kt", frames, rng.normal(size=(K, 2)))
            np.testing.assert_allclose(unit**2 * forms(other, v), forms(one, v))


def test_scans():
    torus, cloud = torus_cloud(2000)
    y = np.asarray(cloud.project(torus.random_points(jax.random.key(0), K)))
    rng = np.random.default_rng(0)
    P, frames = definite(K, 3, rng), rotated_frames(cloud, y, rng)
    noise = check_noise(cloud, y, precision=P)
    assert noise is not None and noise.axes is not None
    v = jnp.asarray(rng.normal(size=y.shape))
    v = np.asarray(cloud.tangent_projection(jnp.asarray(y), v))
    np.testing.assert_allclose(forms(noise, v), np.einsum("kt,ktu,ku->k", v, P, v))
    framed = check_noise(cloud, y, precision=P[:, :2, :2], frames=frames)
    assert framed is not None
    exact = rotated_frames(
        torus, torus.project(jnp.asarray(y)), rng
    )  # close to those of the scan
    angles = np.linalg.svd(np.swapaxes(exact, 1, 2) @ noise.axes)[1]
    assert angles.min() > 1 - 1e-3


# What is refused

Y = points_on(SPHERE)
P2, P3 = np.tile(np.eye(2), (K, 1, 1)), np.tile(np.eye(3), (K, 1, 1))
FRAMES = tangent_frames(SPHERE, Y)


def changed(array, index, value):
    array = np.array(array, float)
    array[index] = value
    return array


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sigma": 1.0, "precision": P3}, "sigma, precision: both say .* give one"),
        ({"frames": FRAMES}, "frames: .*`precision` .*missing. Give it"),
        ({"sigma": 1.0, "frames": FRAMES}, "frames: .*`precision` .*missing"),
        ({"sigma": np.ones(4)}, r"sigma: expected one number, or shape \(5,\), .*\(4,\)"),
        ({"sigma": np.ones((K, 2))}, r"found \(5, 2\). If it differs by direction"),
        ({"sigma": [1, 2, 0, -1, 1]}, "sigma: must be positive .*found 0 at index 2"),
        ({"sigma": -2.0}, "sigma: must be positive and finite, found -2. "),
        ({"sigma": [1, None, 2, 3, 4]}, "sigma: .*found nan at index 1"),
        ({"sigma": np.inf}, "sigma: .*found inf"),
        ({"sigma": "0.1"}, "sigma: expected real numbers"),
        ({"precision": np.eye(3)}, r"expected shape \(5, 3, 3\) for Sphere \(t = 3 coord.*"
            r"n = 2\), found \(3, 3\). Give one for each datum: np.broadc"),
        ({"precision": P2}, r"found \(5, 2, 2\).*give the `frames`"),
        ({"precision": P3[:4]}, r"found \(4, 3, 3\)"),
        ({"precision": np.ones(K)}, r"precision: expected shape .*found \(5,\)"),
        ({"precision": np.eye(2), "frames": FRAMES}, r"\(5, 2, 2\).*Frames have n"),
        ({"precision": P3, "frames": FRAMES}, "If it is one of ambient .*leave out `fr"),
        ({"precision": P2, "frames": FRAMES[0]}, r"frames: expected .*\(5, 3, 2\)"),
        ({"precision": changed(P3, (3, 0, 0), np.nan)}, "1 of 5 hold NaN .*index 3"),
        ({"precision": changed(P3, (1, 0, 2), 1e-7)},
            r"1 of 5 are not symmetric, by up to 1e-07 of .*index 1\)"),
        ({"precision": changed(P2, ([2, 4], 0, 0), -1e-9), "frames": FRAMES},
            r"2 of 5 have negative eigenvalues .*least -1e-09 \(first at index 2\)"),
        ({"precision": changed(P3, 2, 0)}, "1 of 5 are zero .*index 2.*weight 0"),
        ({"precision": 1e5 * Y[:, :, None] * Y[:, None]}, "5 of 5 are zero along the tan"),
        ({"precision": P2, "frames": changed(FRAMES, 4, np.nan)}, "frames: 1 of 5 hold"),
        ({"precision": P2, "frames": changed(FRAMES, 3, FRAMES[3] + 1e-5)},
            "frames: 1 of 5 are not tangent .*index 3.*tangent_projection"),
        ({"precision": P2, "frames": changed(FRAMES, 1, 1.01 * FRAMES[1])},
            "frames: 1 of 5 are not orthonormal: .*0.02.*index 1.*qr"),
        ({"precision": P2, "frames": changed(FRAMES, 1, FRAMES[1, :, :1])},
            "frames: 1 of 5 are not orthonormal"),
    ],
)  # fmt: skip
def test_refused(given, message):
    with pytest.raises(ValueError, match=message):
        check_noise(SPHERE, Y, **given)


def test_shapes_of_matrices_are_named():
    y, P = points_on(ROTATIONS), np.tile(np.eye(3), (K, 1, 1))
    with pytest.raises(ValueError, match=r"\(5, 9, 9\) or \(5, 3, 3, 3, 3\) for Spec"):
        check_noise(ROTATIONS, y, precision=P)
    with pytest.raises(
        ValueError, match=r"np.broadcast_to\(precision, \(5, 3, 3, 3, 3\)"
    ):
        check_noise(ROTATIONS, y, precision=np.ones((3, 3, 3, 3)))
    with pytest.raises(ValueError, match=r"\(5, 9, 3\) or \(5, 3, 3, 3\) for Special"):
        check_noise(ROTATIONS, y, precision=P, frames=P)


# Tables of directions


def test_means_of_fisher():
    """Scatter and 95 % cones of 4,000 means of 12 directions."""
    kappa, n = 40, 12
    fisher = stats.vonmises_fisher([0.0, 0.0, 1.0], kappa)
    rng = np.random.default_rng(0)
    means = fisher.rvs(4000 * n, random_state=rng).reshape(4000, n, 3).sum(axis=1)
    means /= np.linalg.norm(means, axis=1, keepdims=True)
    assert np.std(means[:, :2]) == pytest.approx(mr.from_kappa(kappa, n), rel=0.02)
    angles = np.degrees(np.arccos(means[:, 2]))
    assert np.mean(angles < mr.a95_of(kappa, n)) == pytest.approx(0.95, abs=0.01)


def test_conversions():
    assert mr.from_a95(180 / np.pi) == pytest.approx(
        1 / np.sqrt(stats.chi2.ppf(0.95, 2))
    )
    assert mr.from_kappa(25.0) == 0.2
    np.testing.assert_allclose(mr.from_kappa([25, 100], n=[4, 1]), 0.1)
    np.testing.assert_allclose(
        mr.a95_of(pd.Series([100.0, 400.0]), 1), [14, 7], rtol=2e-3
    )
    kappa, n = np.array([12.0, 80.0, 700.0]), [30, 8, 1]
    np.testing.assert_allclose(
        mr.from_a95(mr.a95_of(kappa, n)), mr.from_kappa(kappa, n)
    )
    assert isinstance(mr.from_a95(2.0), float)
    weights = mr.datasets.polar_wander().weights
    precisions = np.asarray(mr.from_a95(mr.datasets.polar_wander().a95)) ** -2.0
    np.testing.assert_allclose(precisions / precisions.mean(), weights)


@pytest.mark.parametrize(
    ("convert", "message"),
    [
        (lambda: mr.from_a95([1.0, 0.0, -1.0]), "a95: must be pos.*found 0 at index 1"),
        (lambda: mr.from_a95(pd.Series([1.0, None])), "a95: .*found nan at index 1"),
        (lambda: mr.from_a95(np.ones((2, 2))), r"a95: expected .*found \(2, 2\)"),
        (lambda: mr.from_kappa(-3.0), "kappa: must be positive and finite, found -3. "),
        (lambda: mr.from_kappa([1.0, np.inf]), "kappa: .*found inf at index 1"),
        (lambda: mr.from_kappa(30.0, 0), "n: must be positive and finite, found 0"),
        (
            lambda: mr.a95_of([30.0, 20.0], [5, 6, 7]),
            "n: expected one number, or 2.*nd 3",
        ),
        (lambda: mr.a95_of("30", 5), "kappa: expected real numbers"),
    ],
)
def test_conversions_refused(convert, message):
    with pytest.raises(ValueError, match=message):
        convert()
