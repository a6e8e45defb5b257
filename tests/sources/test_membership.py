"""Points are on a manifold, or the message says which are not: whatever the unit, the
origin, and the size of what stands beside them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import MANIFOLDS

import manireg as mr
from manireg._sources.checks import check_points

SO3, SPACE, SPHERE = mr.SpecialOrthogonal(3), mr.Euclidean(3), mr.Sphere(2)
UTM = np.array([5e5, 5.2e6, 350.0]) + np.outer(np.arange(8.0), [1, 2, 0])
STILL = np.tile(np.eye(3), (8, 1, 1))


def points_of(manifold, n=6):
    return np.array(manifold.random_points(jax.random.key(1), n))


def changed(array, index, value):
    array = array.copy()
    array[index] = value
    return array


def beside(*parts):
    return np.concatenate([np.reshape(part, (len(part), -1)) for part in parts], axis=1)


SLOW = ("quartic", "curve")  # to compile


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else [])
        for name in MANIFOLDS
        if name != "euclidean"
    ],
)
def test_a_thousandth_of_the_reach_is_off(name):
    """Rounding, and data in single precision, are not."""
    manifold = MANIFOLDS[name]
    y = points_of(manifold)
    check_points("y", manifold, y)
    check_points("y", manifold, y.astype(np.float32))
    reach = min(1.0, float(manifold.reach))
    noise = np.random.default_rng(3).normal(size=y[4].shape)
    wrong = changed(y, 4, y[4] + 1e-3 * reach * noise)
    with pytest.raises(
        ValueError, match=r"y: 1 of 6 points lie off .*first at index 4,"
    ):
        check_points("y", manifold, wrong)


@pytest.mark.parametrize("scale", [1e-9, 1e-3, 1.0, 1e6, 1e9])
@pytest.mark.parametrize("of_scale", [mr.Sphere, None])
def test_the_unit_does_not_matter(scale, of_scale):
    manifold = mr.Cylinder(scale) if of_scale is None else of_scale(2, scale)
    y = scale * points_of(mr.Cylinder() if of_scale is None else SPHERE)
    check_points("y", manifold, y)
    wrong = y.copy()
    wrong[2, :2] *= 1 + 1e-4
    with pytest.raises(ValueError, match="1 of 6 .*index 2"):
        check_points("y", manifold, wrong)


@pytest.mark.parametrize("offset", [0.0, 1e3, 1e7])
def test_the_place_along_a_cylinder_does_not_matter(offset):
    cylinder = mr.Cylinder()
    y = points_of(cylinder) + np.array([0, 0, offset])
    check_points("y", cylinder, y)
    with pytest.raises(ValueError, match="1 of 6 points lie off Cylinder .*index 3"):
        check_points("y", cylinder, changed(y, (3, slice(2)), 1.001 * y[3, :2]))


def test_a_far_level_set():
    ball = mr.LevelSet(
        lambda p: jnp.sum((p - 1e6) ** 2) - 1.0, 3, reach=1.0, center=1e6
    )
    y = 1e6 + points_of(SPHERE)
    check_points("y", ball, y)
    wrong = changed(y, 1, 1e6 + 1.001 * (y[1] - 1e6))
    with pytest.raises(ValueError, match="1 of 6 points lie off LevelSet .*index 1"):
        check_points("y", ball, wrong)


@pytest.mark.parametrize(
    ("manifold", "good", "wrong", "factor"),
    [
        (
            mr.Product(SO3, SPACE),
            beside(STILL, UTM),
            beside(changed(STILL, (5, 0, 1), 0.5), UTM),
            "factor 0, SpecialOrthogonal",
        ),
        (
            mr.Product(SPACE, mr.Product(mr.Sphere(2, 1e-3), SPACE)),
            beside(UTM, np.tile([0, 0, 1e-3], (8, 1)), UTM),
            beside(UTM, changed(np.tile([0, 0, 1e-3], (8, 1)), (5, 2), 1.001e-3), UTM),
            "factor 1, factor 0, Sphere",
        ),
        (
            mr.Product(mr.Cylinder(), mr.Sphere(2, 6.4e6)),
            beside(np.tile([1, 0, 1e6], (8, 1)), np.tile([0, 0, 6.4e6], (8, 1))),
            beside(
                changed(np.tile([1, 0, 1e6], (8, 1)), (5, 0), 0.9),
                np.tile([0, 0, 6.4e6], (8, 1)),
            ),
            "factor 0, Cylinder",
        ),
        (
            mr.FlatTorus(2, jnp.array([1e6, 1.0])),
            np.tile([1e6, 0, 0, 1], (8, 1)),
            changed(np.tile([1e6, 0, 0, 1.0], (8, 1)), (5, 3), 1.01),
            "FlatTorus, circle 1",
        ),
    ],
    ids=["pose", "nested", "cylinder", "torus"],
)
def test_each_factor_has_its_own_size(manifold, good, wrong, factor):
    check_points("y", manifold, good)
    message = rf"y: 1 of 8 points lie off {factor} \(first at index 5, up to"
    with pytest.raises(ValueError, match=message):
        check_points("y", manifold, wrong)
    with pytest.raises(ValueError, match=message.replace("y:", "p:")):
        mr.geodesic(manifold, wrong, good)


def flipped(*rows):
    mirror = STILL.copy()
    mirror[list(rows), :, 2] *= -1
    return mirror


@pytest.mark.parametrize(
    ("manifold", "y", "message"),
    [
        (
            SO3,
            flipped(3),
            r"1 of 8 matrices are reflections.*SpecialOrthogonal.*index 3",
        ),
        (SO3, flipped(*range(8)), "8 of 8 matrices are reflections.*index 0"),
        (SO3, STILL[:, [1, 0, 2]], "8 of 8 matrices are reflections"),
        (
            mr.Product(SO3, SPACE),
            beside(flipped(3, 6), UTM),
            "2 of 8 matrices are reflections.*factor 0, Spec.*index 3",
        ),
        (
            mr.Product(SPACE, mr.Product(SPHERE, mr.SpecialOrthogonal(2))),
            beside(UTM, np.tile([0, 0, 1], (8, 1)), np.tile([1, 0, 0, -1], (8, 1))),
            "8 of 8 matrices are reflections.*factor 1, factor 1, Spec.*index 0",
        ),
        (
            mr.SpecialOrthogonal(4),
            np.tile(np.diag([1, 1, -1, 1]), (8, 1, 1)),
            "8 of 8 matrices are reflections",
        ),
    ],
    ids=["one", "all", "swapped", "pose", "nested", "of four"],
)
def test_reflections_are_named(manifold, y, message):
    with pytest.raises(ValueError, match=f"y: {message}"):
        check_points("y", manifold, y)


def test_the_medial_axis_is_off():
    y = changed(points_of(SPHERE), 2, 0.0)
    message = r"1 of 6 points lie off Sphere \(first at index 2, up to 1 away\)"
    with pytest.raises(ValueError, match=message):
        check_points("y", SPHERE, y)


@pytest.mark.parametrize(
    "source",
    [
        mr.Box([0] * 4, [1] * 4),
        mr.Sphere(4),
        mr.Euclidean(5),
        mr.Product(SPHERE, SPHERE),
        mr.Ambient(mr.SpecialOrthogonal(4)),
    ],
)
def test_no_minimiser_of_order_two_above_dimension_three(source):
    x = np.zeros((9, *source.point_shape))
    with pytest.raises(
        ValueError, match=r"order: \w+ has dimension \d, .* of order 2 have no min"
    ):
        mr.make_problem(source, SPACE, x, np.zeros((9, 3)))
