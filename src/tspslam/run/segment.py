"""``tspslam segment``: the regions of a map, a frame or a mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..apps.segment import segment
from .given import Given


def find_regions(given: Given, scale: float = 1.0) -> NDArray[np.int32]:
    """Segment what a run or a file holds by all that it has: signals, response, places.

    Parameters
    ----------
    given : Given
        As `open_given` reads it.
    scale : float
        Larger: fewer regions, as `tspslam.segment`.

    Returns
    -------
    (F,) int32
        The region of each face.

    Raises
    ------
    InputError
        If the scale is none.
    """
    return segment(given.complex_, given.signals, given.response, scale=scale, xyz=given.xyz)
