"""Which triangles of a scene a camera may see: those that reach into its frustum."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...types import FloatArray, Rig
from .shapes import Scene

_MARGIN = 2.0  # px around the image
_SLACK = 1e-9  # of a distance, for rounding


class Corners:
    """Corners of all triangles of a scene, and a ball around each of them; a scene stands still but for its velocities.

    Parameters
    ----------
    scene : Scene
        The world.
    """

    def __init__(self, scene: Scene) -> None:
        shapes = scene.shapes
        self._corners = np.concatenate([shape.world_vertices()[shape.faces] for shape in shapes])
        self._velocity = np.repeat([shape.velocity for shape in shapes], [len(shape.faces) for shape in shapes], axis=0)
        self._moves = bool(self._velocity.any())
        self._centre = self._corners.mean(axis=1)
        self._radius: FloatArray = np.linalg.norm(self._corners - self._centre[:, None], axis=2).max(axis=1)

    def seen(self, rig: Rig, cx: float, pose: FloatArray, stamp: float) -> tuple[NDArray[np.int64], FloatArray]:
        """Triangles that a camera may see, and their corners in its frame.

        Parameters
        ----------
        rig : Rig
            Its lens.
        cx : float
            Its principal column, px, in place of the rig's.
        pose : (4, 4) float64
            World from camera, m.
        stamp : float
            Time, s.

        Returns
        -------
        (K,) int64
            Which, ascending.
        (K, 3, 3) float64
            Their corners, m.
        """
        R, t = pose[:3, :3], pose[:3, 3]
        moved = stamp * self._velocity if self._moves else np.zeros((1, 3))
        centre = (self._centre + moved - t) @ R
        reach = self._radius + _SLACK * (np.abs(centre).max(axis=1) + np.abs(t).max())
        chosen = np.flatnonzero((centre @ _planes(rig, cx).T >= -reach[:, None]).all(axis=1))
        corners = self._corners[chosen] + (moved[chosen, None] if self._moves else 0)
        return chosen, ((corners - t).reshape(-1, 3) @ R).reshape(-1, 3, 3)


def _planes(rig: Rig, cx: float) -> FloatArray:
    """(5, 3) unit normals of a frustum's sides, inwards; it begins at the camera's plane."""
    u, v = np.array([rig.fx, rig.skew, cx]), np.array([0, rig.fy, rig.cy])
    low, right, bottom = (0, 0, _MARGIN), (0, 0, rig.width + _MARGIN), (0, 0, rig.height + _MARGIN)
    normals = np.array([(0, 0, 1), u + low, right - u, v + low, bottom - v])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)
