from ._base import AbstractManifold as AbstractManifold
from ._cylinder import Cylinder as Cylinder
from ._doubts import doubt as doubt
from ._ellipsoid import Ellipsoid as Ellipsoid
from ._euclidean import Euclidean as Euclidean
from ._flat_torus import FlatTorus as FlatTorus
from ._generic import (
    broadcast_points as broadcast_points,
    geodesic_exp as geodesic_exp,
    second_form_of_projection as second_form_of_projection,
)
from ._grassmann import Grassmann as Grassmann
from ._implicit import (
    implicit_projection as implicit_projection,
    implicit_solution as implicit_solution,
)
from ._laws import check_manifold as check_manifold
from ._level_set import LevelSet as LevelSet
from ._planar_shapes import PlanarShapes as PlanarShapes
from ._point_cloud import PointCloud as PointCloud
from ._product import Product as Product
from ._shooting import shooting_log as shooting_log
from ._spd import SymmetricPositiveDefinite as SymmetricPositiveDefinite
from ._special_orthogonal import SpecialOrthogonal as SpecialOrthogonal
from ._sphere import Sphere as Sphere
from ._stiefel import Stiefel as Stiefel
from ._torus import Torus as Torus
