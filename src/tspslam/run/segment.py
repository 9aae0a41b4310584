"""``tspslam segment``: the regions of a map, a frame or a mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..apps.segment import segment
from .given import Given


def find_regions(given: Given, scale: float = 1.0) -> NDArray[np.int32]:
    """Segment what a run or a file holds by signals and places; responses did not better regions (docs/segment.rst).

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
    return segment(given.complex_, given.signals, scale=scale, xyz=given.xyz, covariance=given.covariance)


def columns_of(labels: NDArray[np.int32], output: Path) -> dict[str, NDArray[Any]]:
    """Make the columns of faces that carry regions to a file.

    Parameters
    ----------
    labels : (F,) int32
        The region of each face.
    output : path
        The file: PLY has colours too, which viewers show at once.

    Returns
    -------
    dict of (F,) arrays
        ``region``, and for PLY ``red``, ``green``, ``blue``.
    """
    from ..view.uses import region_colours

    columns: dict[str, NDArray[Any]] = {"region": labels}
    if output.suffix.lower() == ".ply":
        rgb = np.rint(255 * region_colours(labels)).astype(np.uint8)
        columns |= dict(zip(("red", "green", "blue"), rgb.T, strict=True))
    return columns
