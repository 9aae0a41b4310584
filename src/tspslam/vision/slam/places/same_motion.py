"""Whether two poses of one camera are the same, as far as descriptors tell: what confirms a place."""

from __future__ import annotations

import numpy as np

from ....types import FloatArray
from ...se3 import inverse, rotation_angle
from .settings import LoopSettings


def is_same_motion(T: FloatArray, expected: FloatArray, depth: float, loops: LoopSettings) -> bool:
    """Tell whether two poses of one camera are the same, as far as P3P from descriptors is good.

    Parameters
    ----------
    T, expected : (4, 4) float64
        The two, m.
    depth : float
        Of what the camera sees, m.
    loops : LoopSettings
        How far they may be apart (`same_motion`): by so much of the depth, and by the angle that moves a point so far.

    Returns
    -------
    bool
    """
    off = inverse(expected) @ T
    return bool(
        np.linalg.norm(off[:3, 3]) <= loops.same_motion * depth and rotation_angle(off[:3, :3]) <= loops.same_motion
    )
