"""What a camera sees of a cloud or a mesh: projection with a depth buffer."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..types import FloatArray, Rig
from .rig import project

_WIDEST = 15  # px


def visible_uv(
    rig: Rig, xyz: ArrayLike, faces: ArrayLike | None = None, *, radius: int = 1, tolerance: float = 0.05
) -> FloatArray:
    """Pixels at which the left camera sees points, as `project`; NaN also for those that others hide.

    A depth buffer of the image's size takes the nearest depth at each pixel: of the faces, drawn as they stand in
    space, or, without faces, of every point drawn as a square. A point is seen if it is not farther than that. Points
    may be all around the camera: those with z <= 0 are NaN, and a face with such a corner hides nothing.

    Parameters
    ----------
    rig : Rig
        The cameras.
    xyz : (N, 3) float array
        Points in the left camera's frame, m.
    faces : (F, 3) integers, optional
        Triangles over them.
    radius : int
        Half side of the square that a point hides, px; 0 to 15. Without meaning where there are faces.
    tolerance : float
        Share of its depth by which a seen point may lie behind the buffer.

    Returns
    -------
    (N, 2) float64
        Every point keeps its row, also one outside the image, which nothing hides.

    Raises
    ------
    InputError
        If a shape, a face's vertex or a setting is not as described.

    Examples
    --------
    >>> rig = Rig(fx=50, fy=50, cx=32, cy=24, baseline=0.1, width=64, height=48)
    >>> visible_uv(rig, [[0, 0, 1.0], [0, 0, 2.0], [2, 0, 2.0], [0, 0, -1.0]]).tolist()
    [[32.0, 24.0], [nan, nan], [82.0, 24.0], [nan, nan]]
    """
    from ._visibility import draw_faces, draw_points, hide

    if not (isinstance(radius, int | np.integer) and 0 <= radius <= _WIDEST and 0 <= tolerance <= 1):
        raise InputError(f"radius, tolerance are {radius}, {tolerance}, expected 0 to {_WIDEST} px and 0 to 1")
    uv, points = project(rig, xyz), np.ascontiguousarray(xyz, np.float64)
    inverse = np.zeros((rig.height, rig.width), np.float32)  # 1 / z of the nearest: 0 is empty
    if faces is None:
        draw_points(uv, points[:, 2], radius, inverse)
    else:
        draw_faces(uv, points[:, 2], _checked_faces(faces, len(points)), inverse)
    hide(uv, points[:, 2], 1 + tolerance, inverse)
    return uv


def _checked_faces(faces: ArrayLike, n: int) -> np.ndarray:
    triples = np.asarray(faces)
    if triples.ndim != 2 or triples.shape[1] != 3 or triples.dtype.kind not in "iu":
        raise InputError(f"faces are {triples.dtype} of shape {triples.shape}, expected (F, 3) integers")
    if triples.size and not 0 <= triples.min() <= triples.max() < n:
        raise InputError(f"faces name vertices {triples.min()} to {triples.max()}, expected 0 to {n - 1}")
    return np.ascontiguousarray(triples, np.int64)
