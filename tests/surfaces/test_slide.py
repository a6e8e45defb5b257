"""Sliding semilandmarks, against scipy's thin plates and minimiser."""

import numpy as np
import pytest
import trimesh
from scipy.interpolate import RBFInterpolator
from scipy.optimize import minimize
from scipy.spatial import procrustes
from scipy.spatial.transform import Rotation

import manireg as mr


def energy(reference, y):
    """Of scipy's interpolant: its coefficients against the values."""
    kernel = {2: "thin_plate_spline", 3: "linear"}[reference.shape[1]]
    return np.sum(y * coefficients(reference, y, kernel))


def coefficients(reference, y, kernel):
    plate = RBFInterpolator(reference, y, kernel=kernel, degree=1)
    return plate._coeffs[: len(reference)]  # type: ignore[attr-defined]


def tangents(y, data):
    """Row of the landmark and direction of each slide."""
    slides = []
    for before, at, after in data.curves:
        t = y[after] - y[before]
        slides.append((at, t / np.linalg.norm(t)))
    for at in data.surfaces:
        near = np.argsort(np.linalg.norm(y - y[at], axis=1))[:5]
        values, vectors = np.linalg.eigh(np.cov(y[near].T))
        slides += [(at, vectors[:, 1]), (at, vectors[:, 2])]
    return slides


def by_least_squares(reference, y, slides):
    """The exact minimum: the normal equations of the coefficients of scipy's plates, one
    plate for each slide."""
    moves = np.zeros((len(slides), *y.shape))
    for i, (at, t) in enumerate(slides):
        moves[i, at] = t
    plates = np.stack([coefficients(reference, move, "linear") for move in moves])
    form = np.einsum("ris,jis->rj", moves, plates)
    pull = np.einsum("ris,is->r", plates, y)
    return y - np.einsum("r,ris->is", np.linalg.solve(form, pull), moves)


@pytest.fixture(scope="module")
def data(data_folder):
    return mr.datasets.scallops()


def test_scallops_reach_the_exact_minimum(data):
    reference = data.landmarks[0]
    for y in data.landmarks[1:]:
        slid = mr.slide(y, data.curves, data.surfaces, reference=reference)
        exact = by_least_squares(reference, y, tangents(y, data))
        least, before = energy(reference, exact), energy(reference, y)
        assert energy(reference, slid.landmarks) <= 1.0001 * least
        assert least < 0.6 * before
        np.testing.assert_allclose(slid.landmarks, exact, atol=1e-6 * np.ptp(y))
        np.testing.assert_allclose(slid.energies, least, rtol=1e-6)
        np.testing.assert_allclose(slid.energies_before, before, rtol=1e-6)


def test_no_slide_is_lower(data):
    """A minimiser without derivatives of ours finds nothing lower."""
    reference, y = data.landmarks[:2]
    slides = tangents(y, data)[:11]
    rows, vectors = np.array([at for at, _ in slides]), np.stack([t for _, t in slides])

    def after(lengths):
        moved = y.copy()
        np.add.at(moved, rows, lengths[:, None] * vectors)
        return energy(reference, moved)

    slid = mr.slide(y, data.curves, reference=reference)
    lowest = minimize(after, np.zeros(11), method="BFGS").fun
    assert float(slid.energies) == pytest.approx(lowest, rel=1e-6)


def procrustes_spread(landmarks):
    """Mean disparity of all pairs, by scipy."""
    pairs = [procrustes(a, b)[2] for a in landmarks for b in landmarks]
    return np.mean(pairs)


def test_several_slide_onto_their_mean(data):
    slid = mr.slide(data.landmarks, data.curves, data.surfaces)
    assert np.all(slid.energies < slid.energies_before)
    assert slid.energies.sum() < 0.55 * slid.energies_before.sum()
    assert slid.rounds >= 1
    spread = [procrustes_spread(a) for a in (data.landmarks, slid.landmarks)]
    assert spread[1] < 0.5 * spread[0]
    for y, moved, least in zip(
        data.landmarks, slid.landmarks, slid.energies, strict=True
    ):
        assert energy(slid.reference, moved) == pytest.approx(least, rel=1e-6)
        fixed = [0, 1, 2, 3, 4]
        np.testing.assert_array_equal(moved[fixed], y[fixed])
    # pose and size of the specimens mean nothing
    turn = Rotation.from_rotvec([0.5, -0.7, 1.4]).as_matrix()
    other = data.landmarks.copy()
    other[2] = 3e-3 * other[2] @ turn.T + 40
    again = mr.slide(other, data.curves, data.surfaces)
    back = (again.landmarks[2] - 40) @ turn / 3e-3
    np.testing.assert_allclose(back, slid.landmarks[2], atol=1e-3 * np.ptp(back))


def test_as_data_of_a_map(data):
    """The same by the precision of the data, up to the region: energies of maps end at a
    box, those of thin plates do not."""
    reference, y = data.landmarks[:2]
    precision = np.tile(np.eye(3), (len(y), 1, 1))
    for before, at, after in data.curves:
        t = (y[after] - y[before]) / np.linalg.norm(y[after] - y[before])
        precision[at] -= np.outer(t, t)
    for at, first, second in zip(
        *[iter(tangents(y, data)[11:])] * 2, data.surfaces, strict=True
    ):
        n = np.cross(at[1], first[1])
        precision[second] = np.outer(n, n)
    space = mr.Euclidean(3)
    problem = mr.make_problem(space, space, reference, y, precision=precision)
    move = np.asarray(mr.solve(problem, 1e-6)(reference)) - y
    moved = y + move - np.einsum("nij,nj->ni", precision, move)
    least = mr.slide(y, data.curves, data.surfaces, reference=reference).energies
    assert energy(reference, moved) < min(1.5 * least, 0.4 * energy(reference, y))


def test_back_on_a_scan():
    """Points of an ellipsoid, an affine image of a sphere, moved along it at random: they
    slide back to where the map is affine."""
    mesh = trimesh.creation.icosphere(4)
    stretch = np.diag([1.0, 1.2, 0.8])
    scan = trimesh.Trimesh(mesh.vertices @ stretch, mesh.faces, process=False)
    random = np.random.default_rng(0)
    reference = random.normal(size=(40, 3))
    reference /= np.linalg.norm(reference, axis=1, keepdims=True)
    flat = np.arange(12, 40)
    moved = (
        reference
        + 0.1 * random.normal(size=reference.shape) * (np.arange(40) >= 12)[:, None]
    )
    moved = moved / np.linalg.norm(moved, axis=1, keepdims=True) @ stretch
    slid = mr.slide(moved, surfaces=flat, reference=reference, scans=scan)
    assert slid.energies < 1e-3 * slid.energies_before
    gap = np.linalg.norm(slid.landmarks - reference @ stretch, axis=1)
    assert gap.max() < 0.2 * np.linalg.norm(moved - reference @ stretch, axis=1).max()
    on_scan = np.linalg.norm(slid.landmarks @ np.linalg.inv(stretch), axis=1)
    np.testing.assert_allclose(on_scan, 1.0, atol=2e-3)


def test_in_the_plane():
    """Points of a circle, shifted along tangents: back where the map is affine."""
    angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    reference = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    reference = np.concatenate([reference, [[0.2, 0.1], [-0.3, 0.4], [0.1, -0.5]]])
    k = np.arange(1, 16, 2)
    curves = np.stack([k - 1, k, (k + 1) % 16], axis=1)
    chord = reference[curves[:, 2]] - reference[curves[:, 0]]
    y = reference.copy()
    y[k] += 0.3 * np.sin(k)[:, None] * chord
    slid = mr.slide(y, curves, reference=reference)
    np.testing.assert_allclose(slid.landmarks, reference, atol=1e-9)
    assert float(slid.energies) < 1e-12 < slid.energies_before


X = np.random.default_rng(0).normal(size=(6, 3))


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((X,), {}, "reference: one specimen"),
        ((X[:, :1],), {}, r"landmarks: expected shape \(n, s\)"),
        ((X, [[0, 1, 6]]), {"reference": X}, "curves: landmark 6 does not exist"),
        ((X, [[0, 1]]), {"reference": X}, r"curves: expected .* \(c, 3\)"),
        ((X, [[0, 1, 2]], [1]), {"reference": X}, "landmark 1 slides twice"),
        ((X,), {"reference": X[:5]}, r"reference: expected shape \(6, 3\)"),
        ((X,), {"reference": X * [1, 1, 0]}, "reference: 6 landmarks in a plane"),
        ((X,), {"reference": X * np.nan}, "NaN"),
        ((X[:, :2], None, [1]), {"reference": X[:, :2]}, "on curves only"),
        ((np.stack([X, X]),), {"scans": trimesh.creation.icosphere(2)}, "expected 2"),
        ((X,), {"reference": X[[0, 0, 2, 3, 4, 5]]}, "at one place"),
    ],
)
def test_bad_input(arguments, options, message):
    with pytest.raises(ValueError, match=message):
        mr.slide(*arguments, **options)
