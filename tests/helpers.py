"""Lists that several tests run over."""

import jax.numpy as jnp

from manireg import manifolds


def quartic(p):
    return jnp.sum(p**4) - 1.0


def two_equations(p):
    """A closed space curve: the unit sphere cut by a parabolic cylinder."""
    return jnp.stack([p @ p - 1.0, p[2] - p[0] ** 2 + 0.2])


MANIFOLDS = {
    "euclidean": manifolds.Euclidean(3),
    "circle": manifolds.Sphere(1, 2.0),
    "sphere": manifolds.Sphere(2),
    "sphere3": manifolds.Sphere(3, 0.5),
    "flat_torus": manifolds.FlatTorus(2, jnp.array([1.0, 2.0])),
    "torus": manifolds.Torus(2.0, 0.8),
    "cylinder": manifolds.Cylinder(1.5),
    "ellipsoid": manifolds.Ellipsoid([1.0, 1.5, 2.0]),
    "product": manifolds.Product(
        manifolds.Sphere(2), manifolds.Euclidean(1), manifolds.Cylinder()
    ),
    "scaled": manifolds.Product(
        manifolds.Sphere(2), manifolds.Euclidean(1), scales=(0.3, 5.0)
    ),
    "quartic": manifolds.LevelSet(quartic, 3, reach=0.39),
    "curve": manifolds.LevelSet(two_equations, 3),
    "so2": manifolds.SpecialOrthogonal(2),
    "so3": manifolds.SpecialOrthogonal(3),
    "se3": manifolds.SpecialEuclidean(3, length=0.4),
    "so4": manifolds.SpecialOrthogonal(4),
    "stiefel": manifolds.Stiefel(4, 2),
    "grassmann": manifolds.Grassmann(4, 2),
    "shapes": manifolds.PlanarShapes([[0.0, 0.0], [2.0, 0.3], [1.7, 1.5], [-0.4, 1.1]]),
    "spd": manifolds.SymmetricPositiveDefinite(3),
    "hyperbolic": manifolds.Hyperbolic(2, 1.5),
    "affine_spd": manifolds.AffineInvariantSPD(2),
    "own_metrics": manifolds.Product(
        manifolds.Hyperbolic(2), manifolds.Sphere(2), scales=(2.0, 0.5)
    ),
}
