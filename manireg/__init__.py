"""Non-parametric regression between Riemannian manifolds."""

from importlib.metadata import version as _version

from . import (
    apps as apps,
    baselines as baselines,
    datasets as datasets,
    manifolds as manifolds,
    meshes as meshes,
    plot as plot,
)
from ._cache import cache_programs as cache_programs
from ._citation import citation as citation
from ._discretisation.domain import Domain as Domain
from ._files import load as load
from ._geodesics.geodesic import Geodesic as Geodesic, geodesic as geodesic
from ._input.directional import (
    a95_of as a95_of,
    from_a95 as from_a95,
    from_kappa as from_kappa,
)
from ._objective.energy_of_map import (
    eells_energy as eells_energy,
    energy as energy,
    thin_plate_energy as thin_plate_energy,
)
from ._objective.make_problem import make_problem as make_problem
from ._objective.objective import Energies as Energies
from ._objective.problem import Problem as Problem
from ._objective.resolution import ResolutionWarning as ResolutionWarning
from ._objective.robust import (
    AbstractLoss as AbstractLoss,
    Huber as Huber,
    Squared as Squared,
    StudentT as StudentT,
    Tukey as Tukey,
)
from ._objective.terms import AbstractTerm as AbstractTerm
from ._selection.bootstrap import bootstrap as bootstrap
from ._selection.choice import CrossValidation as CrossValidation
from ._selection.cross_validate import cross_validate as cross_validate
from ._selection.fit import fit as fit
from ._selection.lambda_grid import lambda_grid as lambda_grid
from ._selection.leave_one_out import leave_one_out as leave_one_out
from ._selection.sweep import sweep as sweep
from ._solver.derivatives import Differential as Differential
from ._solver.minima import SeveralMinimaWarning as SeveralMinimaWarning
from ._solver.model import RegressionMap as RegressionMap
from ._solver.posterior import Posterior as Posterior
from ._solver.readings import (
    SphereMotion as SphereMotion,
    angular_velocity as angular_velocity,
    sphere_motion as sphere_motion,
)
from ._solver.regions import Region as Region
from ._solver.solve import solve as solve
from ._solver.summary import Summary as Summary
from ._source import AbstractSource as AbstractSource, Chart as Chart
from ._sources.circle import Circle as Circle
from ._sources.sources import Ambient as Ambient, Box as Box, Interval as Interval
from ._surfaces.align import align as align
from ._surfaces.batch import Batch as Batch, register_folder as register_folder
from ._surfaces.certificate import Certificate as Certificate
from ._surfaces.landmarks import (
    Landmarks as Landmarks,
    read_landmarks as read_landmarks,
)
from ._surfaces.register import register as register
from ._surfaces.registration import Registration as Registration
from ._surfaces.slide import Slid as Slid, slide as slide
from .manifolds import (
    AbstractManifold as AbstractManifold,
    AffineInvariantSPD as AffineInvariantSPD,
    Cylinder as Cylinder,
    Ellipsoid as Ellipsoid,
    Euclidean as Euclidean,
    FlatTorus as FlatTorus,
    Grassmann as Grassmann,
    Hyperbolic as Hyperbolic,
    LevelSet as LevelSet,
    PlanarShapes as PlanarShapes,
    PointCloud as PointCloud,
    Product as Product,
    SpecialEuclidean as SpecialEuclidean,
    SpecialOrthogonal as SpecialOrthogonal,
    Sphere as Sphere,
    Stiefel as Stiefel,
    SymmetricPositiveDefinite as SymmetricPositiveDefinite,
    Torus as Torus,
    check_manifold as check_manifold,
)
from .manifolds._scans.surface import Surface as Surface, load_surface as load_surface

__version__ = _version("manireg")
