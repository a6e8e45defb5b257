"""What manifold regression is compared with: older and simpler methods, each a callable
model fitted to the same data by the same rules of cross-validation."""

from ._frechet import frechet_mean as frechet_mean
from ._geodesic_regression import (
    GeodesicRegression as GeodesicRegression,
    geodesic_regression as geodesic_regression,
)
from ._nadaraya_watson import (
    NadarayaWatson as NadarayaWatson,
    nadaraya_watson as nadaraya_watson,
)
from ._projected_thin_plate import (
    ProjectedThinPlate as ProjectedThinPlate,
    projected_thin_plate as projected_thin_plate,
)
from ._surface_warp import (
    SurfaceWarp as SurfaceWarp,
    held_out_errors as held_out_errors,
)
from ._volume_spline import volume_spline as volume_spline
