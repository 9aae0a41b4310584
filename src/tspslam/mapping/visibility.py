"""What a keyframe sees of the map: a depth buffer of its faces, and the vertices that they do not hide."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._brief import brief
from ..types import BoolArray, FloatArray, Rig
from .views import Rows, calibration_matrix, to_camera

STEP = 2
"""Every so many pixels are looked at, both ways: outlines of what hides are as coarse, depths are exact."""

VISIBLE, OUT_OF_VIEW = -1, -2
"""What `Sight.hidden_by` says of a vertex that no face hides, and of one outside the image."""


class Sight(NamedTuple):
    """A keyframe's depth buffer.

    Attributes
    ----------
    points : (N, 3) float64
        (u z, v z, z) of each vertex, in pixels of the buffer and m.
    faces : (F, 3) int32
        Triangles.
    owner : (h, w) int32
        Which face each pixel shows, -1 for none.
    """

    points: FloatArray
    faces: NDArray[np.int32]
    owner: NDArray[np.int32]

    def __repr__(self) -> str:
        return brief(self)

    def hidden_by(self, rows: Rows, margin: FloatArray) -> NDArray[np.int64]:
        """Find the face that hides each of some vertices.

        Parameters
        ----------
        rows : (O,) int64
            Which vertices.
        margin : (O,) float64
            How much nearer a face must be to hide it, m.

        Returns
        -------
        (O,) int64
            Faces, `VISIBLE` or `OUT_OF_VIEW`.
        """
        from . import _visibility

        found = np.empty(len(rows), np.int64)
        _visibility.hide(self.points, self.faces, self.owner, margin, rows, found)
        return found

    def count_pixels(self, is_front: BoolArray, counts: NDArray[np.int64]) -> None:
        """Add to `counts` how many pixels show each face from its front; one for a face between pixels that shows.

        Parameters
        ----------
        is_front : (F,) bool
            Whether the camera is before the face.
        counts : (F,) int64
            Changed.
        """
        from . import _visibility

        _visibility.count_front(self.points, self.faces, self.owner, is_front, counts)


def look(rig: Rig, T_world_camera: FloatArray, xyz: FloatArray, faces: NDArray[np.int32], step: int = STEP) -> Sight:
    """Draw the faces of a map as a keyframe sees them; what hides may be behind the camera in part.

    Parameters
    ----------
    rig : Rig
        The cameras.
    T_world_camera : (4, 4) float64
        The keyframe's pose.
    xyz : (N, 3) float64
        Vertices, m.
    faces : (F, 3) int32
        Triangles.
    step : int
        Every so many pixels are drawn, both ways.

    Returns
    -------
    Sight
    """
    from . import _visibility

    points = to_camera(xyz, T_world_camera) @ calibration_matrix(rig, step).T
    shape = -(-rig.height // step), -(-rig.width // step)
    owner = np.full(shape, -1, np.int32)
    _visibility.draw(points, faces, np.zeros(shape), owner)
    return Sight(points, faces, owner)


def face_normals(xyz: FloatArray, faces: NDArray[np.int32]) -> FloatArray:
    """Normals of faces, of the length of twice their area: towards whom their corners turn counter-clockwise.

    Parameters
    ----------
    xyz : (N, 3) float64
        Vertices, m.
    faces : (F, 3) int32
        Triangles.

    Returns
    -------
    (F, 3) float64
        m².
    """
    corners = xyz[faces]
    normals: FloatArray = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals
