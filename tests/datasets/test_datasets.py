from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import manireg as mr
from manireg import datasets

MEAN = np.array([0.48, -0.6, 0.64])


@pytest.mark.parametrize("kappa", [0.0, 1e-3, 0.7, 5.0, 100.0, 1e4])
def test_von_mises_fisher_agrees_with_scipy(key, kappa):
    n = 20_000
    y = datasets.von_mises_fisher(key, jnp.broadcast_to(MEAN, (n, 3)), kappa)
    if kappa:
        theirs = stats.vonmises_fisher(MEAN, kappa).rvs(n, random_state=0)
    else:
        theirs = stats.uniform_direction(3).rvs(n, random_state=0)
    np.testing.assert_allclose(jnp.linalg.norm(y, axis=-1), 1, atol=1e-15)
    axes = [MEAN, np.cross(MEAN, [0, 0, 1]), np.array([1, 0, 0])]
    for axis in axes:
        pvalue = stats.kstest(y @ axis, theirs @ axis).pvalue
        assert pvalue > 1e-3


def test_von_mises_fisher_moments(key):
    kappa, n = 40.0, 100_000
    y = datasets.von_mises_fisher(key, jnp.broadcast_to(MEAN, (n, 3)), kappa)
    mean_cosine = 1 / np.tanh(kappa) - 1 / kappa
    expected = mean_cosine * MEAN
    np.testing.assert_allclose(y.mean(0), expected, atol=4 / np.sqrt(kappa * n))


def test_von_mises_fisher_keeps_accuracy_at_huge_concentration(key):
    kappa, n = 1e12, 5_000
    y = datasets.von_mises_fisher(key, jnp.broadcast_to(MEAN, (n, 3)), kappa)
    s = jnp.sum((y - MEAN) ** 2, axis=-1) / 2
    assert stats.kstest(kappa * s, "expon").pvalue > 1e-3


@pytest.mark.parametrize("mean", [[0.0, 0, 1], [0, 0, -1], [0, 0, -0.0 - 1], [1, 0, 0]])
def test_von_mises_fisher_at_special_means(key, mean):
    mean = jnp.asarray(mean, float)
    y = datasets.von_mises_fisher(key, jnp.broadcast_to(mean, (20_000, 3)), 50.0)
    cosine = 1 / jnp.tanh(50.0) - 1 / 50
    np.testing.assert_allclose(y.mean(0), cosine * mean, atol=5e-3)


def test_von_mises_fisher_broadcasts_and_batches(key):
    mean = jnp.broadcast_to(MEAN, (4, 5, 3))
    y = datasets.von_mises_fisher(key, mean, jnp.array([1.0, 1e2, 1e4, 1e6, 1e8]))
    assert y.shape == (4, 5, 3)
    spread = jnp.linalg.norm(y - mean, axis=-1).max(0)
    assert jnp.all(spread[1:] < spread[:-1])
    jitted = jax.jit(datasets.von_mises_fisher)(key, mean, 7.0)
    np.testing.assert_allclose(jitted, datasets.von_mises_fisher(key, mean, 7.0))


@pytest.mark.parametrize(
    ("convention", "length", "energy"),
    [("polar", 36.7, 1.04e6), ("azimuth", 41.6, 1.1e5)],
)
def test_line_on_sphere_is_the_papers_curve(key, convention, length, energy):
    """Lengths and Eells energies from mathematics.md 11.6, by finite differences."""
    data = datasets.line_on_sphere(key, 10, 1e3, convention)
    t = np.linspace(0, 1, 40_001)
    c = np.asarray(data.truth(t))
    np.testing.assert_allclose(np.linalg.norm(c, axis=-1), 1, atol=1e-14)
    h = t[1] - t[0]
    assert np.linalg.norm(np.diff(c, axis=0), axis=-1).sum() == pytest.approx(
        length, rel=5e-3
    )
    acceleration = (c[2:] - 2 * c[1:-1] + c[:-2]) / h**2
    inside = c[1:-1]
    along = (acceleration * inside).sum(-1, keepdims=True)
    geodesic_curvature = acceleration - along * inside
    assert (geodesic_curvature**2).sum() * h == pytest.approx(energy, abs=5e3)


def test_line_on_sphere_conventions_at_a_quarter(key):
    phi, theta = 2.5, 1.3 * np.pi / 4 + np.pi * np.sin(np.pi / 4)
    polar = datasets.line_on_sphere(key, 1, 1.0, "polar").truth(0.25)
    sine = np.sin(theta)
    expected = [sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)]
    np.testing.assert_allclose(polar, expected, atol=1e-14)
    azimuth = datasets.line_on_sphere(key, 1, 1.0, "azimuth").truth(0.25)
    cosine = np.cos(phi)
    expected = [cosine * np.cos(theta), cosine * np.sin(theta), np.sin(phi)]
    np.testing.assert_allclose(azimuth, expected, atol=1e-14)


def test_line_on_sphere_samples(key):
    data = datasets.line_on_sphere(key, 2_000, 1e4)
    assert data.x.shape == (2_000,) and data.y.shape == (2_000, 3)
    assert stats.kstest(data.x, "uniform").pvalue > 1e-3
    error = np.linalg.norm(data.y - data.truth(data.x), axis=-1)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(np.sqrt(2) / 100, rel=0.05)
    assert not np.all(np.diff(data.x) >= 0)
    ordered = datasets.line_on_sphere(key, 50, 1e4, sort=True)
    assert np.all(np.diff(ordered.x) >= 0)


def test_line_on_sphere_bad_input(key):
    with pytest.raises(ValueError, match="`k` must be at least 1, found 0"):
        datasets.line_on_sphere(key, 0, 1.0)
    with pytest.raises(ValueError, match="'polar' or 'azimuth', found 'xyz'"):
        datasets.line_on_sphere(key, 5, 1.0, "xyz")


def test_polar_wander():
    plates = datasets.polar_wander_plates()
    assert len(plates) == 7 and "india" in plates
    for plate in plates:
        path = datasets.polar_wander(plate)
        np.testing.assert_array_equal(path.ages, np.arange(0, 321, 10))
        assert path.plate == plate
        norms = np.linalg.norm(path.directions, axis=-1)
        np.testing.assert_allclose(norms, 1, atol=1e-15)
        assert path.weights.mean() == pytest.approx(1)
    india = datasets.polar_wander("india")
    np.testing.assert_allclose(
        india.directions[5], [-0.040637, 0.438058, -0.898028], atol=1e-6
    )
    assert india.a95[5] == 2.6


def test_polar_wander_names_the_plates():
    with pytest.raises(ValueError, match="No plate 'atlantis'; there are: australia,"):
        datasets.polar_wander("atlantis")


def test_palaeomagnetic_poles():
    plates = datasets.palaeomagnetic_plates()
    assert plates[0] == "gondwana" and len(plates) == 18
    everything = datasets.palaeomagnetic_poles()
    assert len(everything.ages) == 594 and np.all(np.diff(everything.ages) >= 0)
    assert np.isnan(everything.a95).sum() == 1  # has no circle in the table
    gondwana = datasets.palaeomagnetic_poles("gondwana")
    assert len(gondwana.ages) == 194 and len(set(gondwana.plates)) == 12
    assert gondwana.ages[0] == gondwana.ages[1] == 1 and gondwana.a95[1] == 4
    first = np.radians(-85.5), np.radians(141.7)
    expected = np.cos(first[0]) * np.cos(first[1]), np.cos(first[0]) * np.sin(first[1])
    np.testing.assert_allclose(gondwana.directions[1], [*expected, np.sin(first[0])])
    counts = [len(datasets.palaeomagnetic_poles(plate).ages) for plate in plates[1:]]
    assert sum(counts) == 594
    assert {*datasets.palaeomagnetic_plates(15)} == {
        "gondwana", *(p for p, n in zip(plates[1:], counts, strict=True) if n >= 15)
    }  # fmt: skip
    with pytest.raises(
        ValueError, match="No plate 'atlantis'; there are: gondwana, am"
    ):
        datasets.palaeomagnetic_poles("atlantis")


def test_a95_weights():
    weights = datasets.a95_weights([1.0, 2.0, 4.0])
    np.testing.assert_allclose(weights / weights[0], [1, 1 / 4, 1 / 16])
    assert weights.mean() == pytest.approx(1)
    gaps = datasets.a95_weights([1.0, 0.0, 2.0, np.nan, 4.0])
    np.testing.assert_allclose(gaps / gaps[0], [1, 1 / 4, 1 / 4, 1 / 4, 1 / 16])
    np.testing.assert_array_equal(datasets.a95_weights([0.0, np.nan]), [1, 1])
    with pytest.raises(ValueError, match="`a95` has negative entries"):
        datasets.a95_weights([1.0, -1.0])


def test_a95_weights_match_the_spread_of_means(key):
    """The mean of N directions has tangent standard deviation a95 / 140 degrees."""
    kappa, size, repeats = 60.0, 20, 4_000
    mean = jnp.broadcast_to(MEAN, (repeats, size, 3))
    means = datasets.von_mises_fisher(key, mean, kappa).mean(1)
    means = np.asarray(means / jnp.linalg.norm(means, axis=-1, keepdims=True))
    sigma = np.sqrt(((means - MEAN) ** 2).sum(-1).mean() / 2)
    assert sigma == pytest.approx(1 / np.sqrt(kappa * size), rel=0.04)


def assert_unit(vectors):
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=-1), 1, atol=1e-15)


def assert_rotations(matrices):
    identity = np.broadcast_to(np.eye(3), matrices.shape)
    np.testing.assert_allclose(
        matrices @ matrices.swapaxes(-1, -2), identity, atol=1e-14
    )
    np.testing.assert_allclose(np.linalg.det(matrices), 1, atol=1e-14)


def test_direction_tables(data_folder):
    poles = datasets.besse2002("IN")
    assert poles.times.shape == (199,) and poles.directions.shape == (199, 3)
    assert_unit(poles.directions)
    dipole = datasets.geomagnetic_dipole()
    assert dipole.times[0] == 1900 and len(dipole.times) == 27
    assert_unit(dipole.directions)
    latitude = np.degrees(np.arcsin(dipole.directions[0, 2]))
    assert latitude == pytest.approx(78.6139, abs=1e-4)
    storms = datasets.hurricanes()
    assert len(storms.hours) == 2443 and len(np.unique(storms.storm)) == 71
    assert_unit(storms.directions)
    arthur = datasets.hurricanes("AL012014")
    assert set(arthur.name) == {"ARTHUR"} and arthur.hours[0] == 0
    np.testing.assert_allclose(
        arthur.directions[0], [0.173422, -0.830127, 0.529919], atol=1e-6
    )
    field = datasets.geomagnetic_direction()
    assert field.locations.shape == field.directions.shape == (2562, 3)
    assert_unit(field.locations)
    assert_unit(field.directions)


def test_rotation_tables(data_folder):
    india = datasets.plate_rotations("India")
    assert len(india.times) < 64 and np.all(np.diff(india.times) > 0)
    assert_rotations(india.rotations)
    turn = datasets.plate_rotations("Australia").rotations[0]
    angle = np.degrees(np.arccos((np.trace(turn) - 1) / 2))
    assert angle == pytest.approx(3.3, abs=1e-3)
    xsens, xio = datasets.imu(), datasets.imu("xio")
    assert len(xsens.times) == 953 and len(xio.times) == 6313
    assert_rotations(xsens.rotations)
    assert_rotations(xio.rotations)
    assert np.diff(xsens.times) == pytest.approx(0.02)
    with pytest.raises(ValueError, match="'xsens' or 'xio', found 'gps'"):
        datasets.imu("gps")


def test_array_tables(data_folder):
    tensors = datasets.diffusion_tensors()
    assert tensors.positions.shape == (938, 3)
    assert np.linalg.eigvalsh(tensors.tensors).min() > 0
    hands, nerves = datasets.hands(), datasets.optical_nerves()
    assert hands.points.shape == (53, 22, 3) and len(hands.labels) == 53
    assert nerves.points.shape == (23, 5, 3) and len(nerves.labels) == 23
    scallops = datasets.scallops()
    assert scallops.landmarks.shape == (5, 46, 3)
    assert scallops.curves.shape == (11, 3) and scallops.surfaces.shape == (30,)


def test_missing_data_say_what_and_how(tmp_path, monkeypatch):
    monkeypatch.setenv("MANIREG_DATA", str(tmp_path))
    with pytest.raises(
        FileNotFoundError, match="so3_imu_xsens.csv is missing. Set the"
    ):
        datasets.imu()
    monkeypatch.setenv("MANIREG_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(
        FileNotFoundError, match="MANIREG_DATA to their folder, or pass"
    ):
        datasets.hands()
    with pytest.raises(FileNotFoundError, match="mine.npz is missing"):
        datasets.hands(tmp_path / "mine.npz")


def test_data_folder_is_found_above(tmp_path, monkeypatch):
    monkeypatch.delenv("MANIREG_DATA", raising=False)
    (tmp_path / "shared" / "data").mkdir(parents=True)
    (tmp_path / "main" / "notebooks").mkdir(parents=True)
    for here in ("main", "main/notebooks"):
        monkeypatch.chdir(tmp_path / here)
        assert datasets.data_folder() == tmp_path / "shared" / "data"


def test_plates_are_those_of_the_table():
    folder = Path(datasets.__file__).parent
    table = datasets.read_table(folder / "s2_polar_wander_torsvik2008.csv")
    assert list(datasets.polar_wander_plates()) == sorted(set(table["plate"]))


def test_read_table(tmp_path):
    file = tmp_path / "table.csv"
    file.write_text("# note\nage, name,x\n\n1,a,0.5\n# more\n2,b,\n", "utf-8-sig")
    table = datasets.read_table(file)
    np.testing.assert_array_equal(table["age"], [1.0, 2.0])
    np.testing.assert_array_equal(table["x"], [0.5, np.nan])
    assert list(table["name"]) == ["a", "b"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "needs a header line and at least one row"),
        ("a,b\n", "needs a header line and at least one row"),
        ("a,a\n1,2\n", "the header has the column `a` twice"),
        ("# c\na,b\n1,2\n\n1,2,3\n", "line 5: 3 fields, but the header has 2 columns"),
    ],
)
def test_read_table_says_what_is_wrong(tmp_path, text, message):
    file = tmp_path / "table.csv"
    file.write_text(text)
    with pytest.raises(ValueError, match=message):
        datasets.read_table(file)


def test_heads():
    with pytest.raises(ValueError, match="makehuman"):
        datasets.heads("mine")
    try:
        pair = datasets.heads("ict", 3, landmarks=20)
    except FileNotFoundError:
        pytest.skip("the shared data are not here")
    assert pair.source_landmarks.shape == (20,) and pair.target_landmarks.shape == (
        20,
        3,
    )
    at = pair.truth[pair.source_landmarks]
    assert np.allclose(at, pair.target_landmarks, atol=1e-3)
    on_target = mr.PointCloud.from_mesh(pair.target).project(jnp.asarray(at))
    gap = np.linalg.norm(np.asarray(on_target) - at, axis=1)
    assert np.median(gap) < 0.1 and gap.max() < 1.0  # some are on the rims of the eyes
