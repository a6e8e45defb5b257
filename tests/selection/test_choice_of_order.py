"""The order of the energy, chosen like lambda."""

import jax
import numpy as np
import pytest
from curves import INTERVAL, X, curve_problem, sphere_data

import manireg as mr
from manireg._selection.orders import orders_of

SPHERE = mr.Sphere(2)


@pytest.fixture(scope="module")
def data():
    return mr.datasets.line_on_sphere(jax.random.key(3), 40, 1000)


@pytest.fixture(scope="module")
def chosen(data):
    return mr.leave_one_out(
        INTERVAL, SPHERE, data.x, data.y, order=(3, 2), progress=False
    )


def test_each_order_has_a_path_of_its_own(chosen, data):
    """That of the lowest criterion is returned."""
    assert [*chosen.paths] == [2, 3]
    for order, path in chosen.paths.items():
        assert path.order == order and [*path.paths] == [order]
        assert path.criterion[path.chosen] == path.criterion.min()
        cut = np.minimum(path.scores, np.quantile(path.scores, 0.9, axis=0)[None])
        np.testing.assert_allclose(path.criterion, cut.mean(0), rtol=1e-12)
        lengths = (path.lams * 1.0) ** (1 / (2 * order)) * 2 * np.pi
        np.testing.assert_allclose(path.wavelengths, lengths, rtol=1e-6)
    best = min(chosen.paths.values(), key=lambda path: float(path.criterion.min()))
    assert chosen.order == best.order and chosen.lam == best.lam
    alone = mr.leave_one_out(INTERVAL, SPHERE, data.x, data.y, progress=False)
    np.testing.assert_array_equal(chosen.paths[2].scores, alone.scores)


def test_a_fit_takes_the_order_chosen(chosen, data):
    model = mr.fit(INTERVAL, SPHERE, data.x, data.y, order=(2, 3), progress=False)
    np.testing.assert_array_equal(model.coefficients, chosen.model.coefficients)
    with pytest.raises(AttributeError, match="not of order 2"):
        chosen.paths[3].model.energies.eells  # noqa: B018
    energies = chosen.paths[2].model.energies
    assert energies.eells == energies.energy


@pytest.mark.slow
def test_folds_choose_an_order(data):
    cv = mr.cross_validate(
        INTERVAL, SPHERE, data.x, data.y, order=(2, 3), folds=4, progress=False
    )
    assert [*cv.paths] == [2, 3]
    for path in cv.paths.values():
        np.testing.assert_allclose(path.criterion, path.scores.mean(0))


def test_orders_that_are_tried():
    points = SPHERE.random_points(jax.random.key(0), 200)
    cloud = mr.PointCloud(points, points)
    assert orders_of("auto", INTERVAL, SPHERE) == (2, 3, 4)
    assert orders_of("auto", mr.Box([0, 0], [1, 1]), SPHERE) == (2, 3)
    assert orders_of("auto", mr.Box([0] * 4, [1] * 4), SPHERE) == (3,)
    assert orders_of("auto", INTERVAL, cloud) == (2, 3)
    assert orders_of("auto", cloud, SPHERE) == (2,)
    assert orders_of([4, 2], INTERVAL, SPHERE) == (2, 4)


def test_auto_leaves_out_orders_that_few_data_do_not_allow():
    """Four can tell order 3, which has three polynomials of no energy, but not order 4."""
    y = sphere_data()[:4]
    cv = mr.leave_one_out(INTERVAL, SPHERE, X[:4], y, order="auto", progress=False)
    assert [*cv.paths] == [2, 3]
    with pytest.raises(
        ValueError, match="at least 5 for a choice of lambda at order 4"
    ):
        mr.leave_one_out(INTERVAL, SPHERE, X[:4], y, order=4)
    with pytest.raises(
        ValueError, match="at least 3 for a choice of lambda at order 2"
    ):
        mr.cross_validate(INTERVAL, SPHERE, X[:2], y[:2], folds=2)


def test_what_cannot_be_chosen():
    y = sphere_data()
    with pytest.raises(ValueError, match="lams: lambda has a unit of its own"):
        mr.leave_one_out(INTERVAL, SPHERE, X, y, [1e-3], order="auto")
    with pytest.raises(ValueError, match="order: a `Problem` has these already"):
        mr.leave_one_out(curve_problem(SPHERE, y), order=3)
    with pytest.raises(ValueError, match="order: expected 1, 2, 3, 4"):
        mr.leave_one_out(INTERVAL, SPHERE, X, y, order="all")
    with pytest.raises(ValueError, match="order: give one where `lam` is given"):
        mr.fit(INTERVAL, SPHERE, X, y, 1e-3, order=(2, 3))
