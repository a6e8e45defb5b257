"""Triangle meshes with the vertex numbers of their files: read, mend, write."""

from ._files import read_mesh as read_mesh, write_mesh as write_mesh
from ._surface import (
    largest_component as largest_component,
    wound_alike as wound_alike,
)
