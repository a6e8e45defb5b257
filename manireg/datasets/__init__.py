"""Data to try the library on: simulated, bundled, and loaders of the shared tables."""

from ._heads import HeadPair as HeadPair, heads as heads
from ._line_on_sphere import (
    LineOnSphere as LineOnSphere,
    line_on_sphere as line_on_sphere,
    von_mises_fisher as von_mises_fisher,
)
from ._loaders import (
    besse2002 as besse2002,
    diffusion_tensors as diffusion_tensors,
    geomagnetic_dipole as geomagnetic_dipole,
    geomagnetic_direction as geomagnetic_direction,
    hands as hands,
    hurricanes as hurricanes,
    imu as imu,
    optical_nerves as optical_nerves,
    plate_rotations as plate_rotations,
    scallops as scallops,
)
from ._polar_wander import (
    PolarWander as PolarWander,
    a95_weights as a95_weights,
    polar_wander as polar_wander,
    polar_wander_plates as polar_wander_plates,
)
from ._poles import (
    PalaeomagneticPoles as PalaeomagneticPoles,
    palaeomagnetic_plates as palaeomagnetic_plates,
    palaeomagnetic_poles as palaeomagnetic_poles,
)
from ._tables import data_folder as data_folder, read_table as read_table
