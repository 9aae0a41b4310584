"""What matching finds, and whether a point's neighbours in the image agree with its disparity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._brief import Brief
from ..._threads import in_halves
from ...types import BoolArray, FloatArray

_NEIGHBOURS = 8
_NEEDED = 2
_SLOPE = 0.1  # px of disparity per px of distance that a slanted surface may show


@dataclass(frozen=True, repr=False)
class Matches(Brief):
    """Keypoints of the left image with their disparities.

    Attributes
    ----------
    left_index : (M,) int64
        Rows of the left features, ascending, each at most once.
    right_index : (M,) int64
        Rows of the right features; -1 where the place was found by searching the row.
    disparity : (M,) float64
        ``u_left - u_right``, px.
    score : (M,) float64
        Similarity of the two patches or descriptors, at most 1.
    vertical_offset_px : float
        Median of ``v_right - v_left`` over the matches.
    vertical_offset_std_px : float
        Its spread: 1.4826 times the median absolute deviation.
    """

    left_index: NDArray[np.int64]
    right_index: NDArray[np.int64]
    disparity: FloatArray
    score: FloatArray
    vertical_offset_px: float = 0.0
    vertical_offset_std_px: float = 0.0

    def __len__(self) -> int:
        return len(self.left_index)


def uv_right(uv: FloatArray, disparity: FloatArray) -> FloatArray:
    """Return where the right image has points of the left one.

    Parameters
    ----------
    uv : (N, 2) float64
        Places in the left image, px.
    disparity : (N,) float64
        Disparities, px.

    Returns
    -------
    (N, 2) float64
        px.

    Examples
    --------
    >>> uv_right(np.array([[30.0, 7.0]]), np.array([5.0])).tolist()
    [[25.0, 7.0]]
    """
    return uv - np.column_stack([disparity, np.zeros(len(disparity))])


def find_supported(uv: FloatArray, disparity: FloatArray, *, tolerance: float) -> BoolArray:
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
    >>> find_supported(np.column_stack([u, u]), np.where(u == 7, 40.0, 5.0), tolerance=1.0).sum()
    np.int64(19)
    """
    if len(uv) <= _NEIGHBOURS:
        return np.ones(len(uv), np.bool_)
    from scipy.spatial import cKDTree

    tree, shape = cKDTree(uv, compact_nodes=False, balanced_tree=False), (len(uv), _NEIGHBOURS + 1)
    distance, neighbour = np.empty(shape), np.empty(shape, np.int64)

    def find(part: slice) -> None:
        distance[part], neighbour[part] = tree.query(uv[part], _NEIGHBOURS + 1)

    in_halves(find, len(uv))
    difference = np.abs(disparity[neighbour] - disparity[:, None])
    agree = difference <= tolerance + _SLOPE * distance
    agrees: BoolArray = np.count_nonzero(agree, axis=1) > _NEEDED  # the point itself agrees too
    return agrees
