"""Whether a point's neighbours in the image agree with its disparity."""

from __future__ import annotations

import numpy as np

from ..types import BoolArray, FloatArray

_NEIGHBOURS = 8
_NEEDED = 2
_SLOPE = 0.1  # px of disparity per px of distance that a slanted surface may show


def supported(uv: FloatArray, disparity: FloatArray, *, tolerance: float) -> BoolArray:
    """Whether at least two of a point's eight nearest neighbours have nearly its disparity.

    "Nearly" is ``tolerance + 0.1 · distance``, so that slanted surfaces pass. With too few points to judge (fewer
    than nine), all pass.

    Parameters
    ----------
    uv : (N, 2) float64
        Places in the image, px.
    disparity : (N,) float64
        Disparities, px.
    tolerance : float
        px.

    Returns
    -------
    (N,) bool

    Examples
    --------
    >>> u = np.arange(20.0)
    >>> supported(np.column_stack([u, u]), np.where(u == 7, 40.0, 5.0), tolerance=1.0).sum()
    np.int64(19)
    """
    if len(uv) <= _NEIGHBOURS:
        return np.ones(len(uv), np.bool_)
    from scipy.spatial import cKDTree

    distance, neighbour = cKDTree(uv, compact_nodes=False, balanced_tree=False).query(uv, _NEIGHBOURS + 1, workers=2)
    difference = np.abs(disparity[neighbour] - disparity[:, None])
    agree = difference <= tolerance + _SLOPE * distance
    agrees: BoolArray = np.count_nonzero(agree, axis=1) > _NEEDED  # the point itself agrees too
    return agrees
