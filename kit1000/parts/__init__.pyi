"""The public names of kit1000.parts, which its `__init__.py` loads on first use."""

from .family import Family as Family
from .family import make_part as make_part
from .family import part_of_mesh as part_of_mesh
from .family_catalog import FAMILIES as FAMILIES
from .files.read import mesh_files as mesh_files
from .files.read import read_mesh as read_mesh
