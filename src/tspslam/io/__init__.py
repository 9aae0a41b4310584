"""Reading and writing: images, PLY, VTU, stored frames and maps, run folders. Files are whole or not there."""

from .._atomic import atomic_write, write_bytes
from .clouds import Scan, read_scan
from .frames import read_frame, write_frame
from .images import image_size, read_image, write_png
from .manifest import Unit
from .mesh import merge_corners, read_mesh, read_polygons, triangulate_polygons
from .ply import PlyMesh, read_ply, write_ply
from .runfolder import RunFolder
from .runs import StoredRun, load_run
from .textured import TexturedMesh, read_textured
from .topological import load_map, read_map, write_map
from .trajectory import read_trajectory, write_kitti, write_tum
from .vtu import VtuMesh, read_vtu, write_vtu

__all__ = [
    "PlyMesh",
    "RunFolder",
    "Scan",
    "StoredRun",
    "TexturedMesh",
    "Unit",
    "VtuMesh",
    "atomic_write",
    "image_size",
    "load_map",
    "load_run",
    "merge_corners",
    "read_frame",
    "read_image",
    "read_map",
    "read_mesh",
    "read_ply",
    "read_polygons",
    "read_scan",
    "read_textured",
    "read_trajectory",
    "read_vtu",
    "triangulate_polygons",
    "write_bytes",
    "write_frame",
    "write_kitti",
    "write_map",
    "write_ply",
    "write_png",
    "write_tum",
    "write_vtu",
]
