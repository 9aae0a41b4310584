"""Worlds with a known truth: textured shapes, ray cast into stereo pairs with exact depth, normals, labels and poses.

A `Scene` is shapes and a camera's path; a `SyntheticSequence` takes pairs along it, with the `Faults` of real cameras::

    scene    = synthetic.street(100)
    sequence = synthetic.SyntheticSequence(scene, faults=synthetic.Faults(noise=0.01))
    pair     = sequence[0]               # as any other reader gives it
    geometry = sequence.geometry(0)      # depth, normal, label, disparity of each pixel of pair.left
    poses    = sequence.truth            # T_world_camera of every frame

A `RawSequence` takes them through lenses, such as fisheyes, and rectifies them.
"""

from . import boards as boards
from .raw import RawSequence as RawSequence
from .render import Geometry as Geometry
from .scanner import Echoes as Echoes
from .scanner import Scanner as Scanner
from .scanner import scan as scan
from .scenes import corridor as corridor
from .scenes import room as room
from .scenes import still as still
from .scenes import street as street
from .sequence import PAPER_RIG as PAPER_RIG
from .sequence import Faults as Faults
from .sequence import SyntheticSequence as SyntheticSequence
from .shapes import Scene as Scene
from .shapes import Shape as Shape
from .shapes import box as box
from .shapes import plane as plane
from .shapes import sphere as sphere
from .shapes import torus as torus
from .texture import Texture as Texture
from .town import town as town
from .town import town_path as town_path

__all__ = [
    "PAPER_RIG", "Echoes", "Faults", "Geometry", "RawSequence", "Scanner", "Scene", "Shape", "SyntheticSequence",
    "Texture", "box", "corridor", "plane", "room", "scan", "sphere", "still", "street", "torus",
    "town", "town_path",
]  # fmt: skip
