"""Triangle meshes with the vertex numbers of their files: read, mend, write."""

from ._components import largest_component as largest_component
from ._read import read_mesh as read_mesh
from ._report import Finding as Finding, Report as Report
from ._winding import wound_alike as wound_alike
from ._write import write_mesh as write_mesh
