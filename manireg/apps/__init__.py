"""What a field asks for, in its words and in one call: thin, above the rest of the
library. Knows no command line."""

from ._trajectory import Trajectory as Trajectory, trajectory as trajectory
