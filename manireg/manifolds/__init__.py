from ._base import AbstractManifold as AbstractManifold
from ._cylinder import Cylinder as Cylinder
from ._defaults.implicit import (
    implicit_projection as implicit_projection,
    implicit_solution as implicit_solution,
)
from ._defaults.logarithm import shooting_log as shooting_log
from ._defaults.second_form import (
    broadcast_points as broadcast_points,
    geodesic_exp as geodesic_exp,
    second_form_of_projection as second_form_of_projection,
)
from ._ellipsoid import Ellipsoid as Ellipsoid
from ._euclidean import Euclidean as Euclidean
from ._flat_torus import FlatTorus as FlatTorus
from ._hyperbolic import Hyperbolic as Hyperbolic
from ._laws import check_manifold as check_manifold
from ._level_set import LevelSet as LevelSet
from ._matrices.affine_invariant_spd import AffineInvariantSPD as AffineInvariantSPD
from ._matrices.grassmann import Grassmann as Grassmann
from ._matrices.spd import SymmetricPositiveDefinite as SymmetricPositiveDefinite
from ._matrices.special_euclidean import SpecialEuclidean as SpecialEuclidean
from ._matrices.special_orthogonal import SpecialOrthogonal as SpecialOrthogonal
from ._matrices.stiefel import Stiefel as Stiefel
from ._planar_shapes import PlanarShapes as PlanarShapes
from ._product import Product as Product
from ._scans.point_cloud import PointCloud as PointCloud
from ._sphere import Sphere as Sphere
from ._torus import Torus as Torus
