"""What a field asks for, in its words: each a few lines around `fit` and its posterior."""

from ._path import PolePath as PolePath, path as path
from ._poles import Poles as Poles
from ._pose_files import PoseTable as PoseTable, read_poses as read_poses
from ._trajectory import Trajectory as Trajectory, trajectory as trajectory
