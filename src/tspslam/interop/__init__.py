"""Interop with other programs: their meshes and models in, complexes and signals in their terms out."""

from .colmap import from_colmap as from_colmap
from .meshes import from_arrays as from_arrays
from .meshes import from_file as from_file
from .meshes import from_trimesh as from_trimesh
from .tensors import to_pyg as to_pyg
from .tensors import to_torch as to_torch
from .toponetx import from_toponetx as from_toponetx
from .toponetx import to_toponetx as to_toponetx

__all__ = [
    "from_arrays",
    "from_colmap",
    "from_file",
    "from_toponetx",
    "from_trimesh",
    "to_pyg",
    "to_toponetx",
    "to_torch",
]  # fmt: skip
