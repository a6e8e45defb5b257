"""The tables of the shared data, one loader each.

`path` is the file itself; without it, the file of that name in `tables/` of the shared
data (see `manireg.datasets.data_folder`). Everything is float64 numpy."""

import os
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from ._tables import directions, find_table, read_table, rows_of, unit

Path = str | os.PathLike[str] | None


class Directions(NamedTuple):
    """`directions` (n, 3), unit vectors, at `times` (n,)."""

    times: Float[np.ndarray, " n"]
    directions: Float[np.ndarray, "n 3"]


class Rotations(NamedTuple):
    """`rotations` (n, 3, 3) at `times` (n,)."""

    times: Float[np.ndarray, " n"]
    rotations: Float[np.ndarray, "n 3 3"]


class Storms(NamedTuple):
    """Fixes of storms: `hours` since the storm's first fix and `directions` (n, 3)."""

    hours: Float[np.ndarray, " n"]
    directions: Float[np.ndarray, "n 3"]
    wind: Float[np.ndarray, " n"]
    """Knots."""
    storm: np.ndarray
    """Identifier of each fix's storm, as `AL012014`."""
    name: np.ndarray


class FieldDirections(NamedTuple):
    """Unit vectors `locations` (n, 3) -> `directions` (n, 3); `intensity` (n,), nT."""

    locations: Float[np.ndarray, "n 3"]
    directions: Float[np.ndarray, "n 3"]
    intensity: Float[np.ndarray, " n"]


class Tensors(NamedTuple):
    """Symmetric positive definite `tensors` (n, 3, 3) in mm^2/s at `positions` (n, 3)
    in mm, with `anisotropy` (n,), the fractional anisotropy."""

    positions: Float[np.ndarray, "n 3"]
    tensors: Float[np.ndarray, "n 3 3"]
    anisotropy: Float[np.ndarray, " n"]


class Landmarks(NamedTuple):
    """Raw `points` (n, landmarks, 3), not yet freed of position, size and rotation."""

    points: Float[np.ndarray, "n landmarks 3"]
    labels: Int[np.ndarray, " n"] | np.ndarray


class Semilandmarks(NamedTuple):
    """Landmarks of specimens, of which some slide (see `manireg.slide`)."""

    landmarks: Float[np.ndarray, "k n 3"]
    curves: Int[np.ndarray, "c 3"]
    """Before, slider, after."""
    surfaces: Int[np.ndarray, " f"]


def besse2002(plate: str = "IN", path: Path = None) -> Directions:
    """Synthetic apparent polar wander (north poles) of one plate, 0 to 200 million
    years at steps of 1, smooth because interpolated: Besse & Courtillot 2002."""
    table = read_table(find_table("s2_polar_wander_besse2002.csv", path))
    table = rows_of(table, "plate", plate)
    poles = directions(table["pole_lat_deg"], table["pole_lon_deg"])
    return Directions(table["age_ma"], poles)


def geomagnetic_dipole(path: Path = None) -> Directions:
    """The north geomagnetic pole, 1900 to 2030, IGRF-14."""
    table = read_table(find_table("s2_geomagnetic_dipole_igrf14.csv", path))
    return Directions(table["year"], unit(_columns(table, "x", "y", "z")))


def plate_rotations(plate: str = "India", path: Path = None) -> Rotations:
    """Finite rotations of a plate against Africa by age in million years (Torsvik et
    al. 2008), without the rows that only repeat the one before."""
    table = read_table(find_table("so3_plate_rotations_torsvik2008.csv", path))
    table = rows_of(table, "plate", plate)
    moving = table["same_as_previous"] == 0
    return Rotations(table["age_ma"][moving], _rotations(table)[moving])


def imu(sensor: str = "xsens", path: Path = None) -> Rotations:
    """Orientation of a moving inertial sensor: `xsens` by time in seconds (50 Hz),
    `xio` by packet number."""
    if sensor not in ("xsens", "xio"):
        raise ValueError(f"`sensor` is 'xsens' or 'xio', found {sensor!r}.")
    table = read_table(find_table(f"so3_imu_{sensor}.csv", path))
    times = table["time_s" if sensor == "xsens" else "packet"]
    return Rotations(times, _rotations(table))


def hurricanes(storm: str | None = None, path: Path = None) -> Storms:
    """North Atlantic tropical cyclones 2014 to 2018, all or one `storm` (as
    `AL012014`): HURDAT2, NOAA."""
    table = read_table(find_table("s2_hurricanes_2014_2018.csv", path))
    if storm is not None:
        table = rows_of(table, "storm", storm)
    return Storms(
        hours=table["hours"],
        directions=directions(table["lat_deg"], table["lon_deg"]),
        wind=table["wind_kt"],
        storm=table["storm"],
        name=table["name"],
    )


def geomagnetic_direction(path: Path = None) -> FieldDirections:
    """Direction of the geomagnetic field on the Earth's surface in 2025, IGRF-14."""
    data = np.load(find_table("s2_to_s2_geomagnetic_direction_2025.npz", path))
    location, direction = unit(data["location"]), unit(data["direction"])
    return FieldDirections(location, direction, data["intensity_nt"])


def diffusion_tensors(path: Path = None) -> Tensors:
    """Diffusion tensors of brain voxels, fitted from the test data of dipy."""
    data = np.load(find_table("spd3_diffusion_tensors.npz", path))
    return Tensors(data["position_mm"], data["tensor_mm2_per_s"], data["fa"])


def hands(path: Path = None) -> Landmarks:
    """53 hands of 22 landmarks with the label of the pose, from geomstats."""
    data = np.load(find_table("kendall_shapes_geomstats.npz", path))
    return Landmarks(data["hands"], data["hand_label"])


def optical_nerves(path: Path = None) -> Landmarks:
    """23 optical nerve heads of 5 landmarks with their identifiers, from geomstats."""
    data = np.load(find_table("kendall_shapes_geomstats.npz", path))
    return Landmarks(data["optical_nerves"], data["optical_nerve_id"])


def scallops(path: Path = None) -> Semilandmarks:
    """46 landmarks of 5 scallops, 11 of them of a curve and 30 of a surface, from
    geomorph."""
    data = np.load(find_table("landmarks_scallops.npz", path))
    return Semilandmarks(data["landmarks"], data["curve_slide"], data["surface_slide"])


def _columns(table: dict[str, np.ndarray], *names: str) -> np.ndarray:
    return np.stack([table[name] for name in names], axis=-1)


def _rotations(table: dict[str, np.ndarray]) -> np.ndarray:
    quaternions = _columns(table, "qw", "qx", "qy", "qz")
    return Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
