"""Patches compared along rows: search in whole pixels, refinement to a fraction, vertical offset."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._brief import Brief
from ..._settings import Checked, setting
from ..._threads import in_halves
from ...types import BoolArray, FloatArray
from ..images import Plane

_MAX_OFFSETS = 128  # matches that the vertical offset is measured on


@dataclass(frozen=True)
class Patches(Checked, what="patches"):
    """Size and weights of the square patches that are compared.

    Parameters
    ----------
    radius : int
        Half width, px.
    contrast : float
        Per grey level (of 255): a pixel that differs from the centre by ``1 / contrast`` counts half.

    Raises
    ------
    InputError
        If a parameter is out of its range.

    Examples
    --------
    >>> from tspslam import RowMatcher
    >>> RowMatcher(patches=Patches(radius=6)).patches.contrast
    0.07
    """

    radius: int = setting(
        4, 1, 15, unit="px",
        source="by hand; Motorcycle: 2, 4, 8 give 1233, 1304, 1193 points, 97.2, 96.2, 96.0 % right to 1 px",
    )  # fmt: skip
    contrast: float = setting(
        0.07, 0.0, 10.0, unit="1 / grey level",
        source="by hand; Motorcycle: 0.03, 0.07, 0.15 give 1373, 1304, 1221 points, 95.0, 96.2, 96.7 % right to 1 px",
    )  # fmt: skip


@dataclass(frozen=True, repr=False)
class Alignment(Brief):
    """Result of `refine`, one row a point.

    Attributes
    ----------
    disparity : (N,) float64
        px.
    score : (N,) float64
        Correlation of the aligned patches.
    gain : (N,) float64
        Contrast of the first patch over that of the second.
    good : (N,) bool
        False where the iteration did not converge or ran away.
    """

    disparity: FloatArray
    score: FloatArray
    gain: FloatArray
    good: BoolArray


def shift_rows(plane: Plane, offset: float) -> Plane:
    """Interpolate a plane at rows moved by an offset: ``out[v] = plane[v + offset]``, six points, edges repeated.

    Parameters
    ----------
    plane : (H, W) float32
        Smoothed plane.
    offset : float
        px, at most 16 either way.

    Returns
    -------
    (H, W) float32

    Examples
    --------
    >>> rows = np.arange(20, dtype=np.float32)[:, None].repeat(3, axis=1)
    >>> float(shift_rows(rows, 0.25)[10, 1])
    10.25
    """
    import cv2

    from ._patches import lagrange_taps

    whole = int(np.floor(offset))
    taps = np.empty(6, np.float32)
    lagrange_taps(offset - whole, taps)
    above, below = min(whole - 2, 0), max(whole + 3, 0)  # rows that are summed up, with that of the sum among them
    column = np.zeros((below - above + 1, 1), np.float32)
    column[whole - 2 - above : whole + 4 - above, 0] = taps
    shifted: Plane = cv2.filter2D(plane, cv2.CV_32F, column, anchor=(0, -above), borderType=cv2.BORDER_REPLICATE)
    return shifted


def search(
    first: Plane, second: Plane, uv: FloatArray, ranges: FloatArray, patches: Patches
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`search_alone` in two threads.

    Parameters, returns: as `search_alone`.
    """
    found = np.empty((3, len(uv)))

    def fill(part: slice) -> None:
        found[:, part] = search_alone(first, second, uv[part], ranges[:, part], patches)

    in_halves(fill, len(uv))
    return found[0], found[1], found[2]


def search_alone(
    first: Plane, second: Plane, uv: FloatArray, ranges: FloatArray, patches: Patches
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Best disparity in whole pixels of the patch around each point of the first image, along its row of the second.

    Parameters
    ----------
    first, second : (H, W) float32
        Smoothed planes.
    uv : (N, 2) float64
        Points of the first image, px; rounded to whole pixels.
    ranges : (2, N) float64
        Smallest and largest ``u_first - u_second``, px.
    patches : Patches
        What to compare.

    Returns
    -------
    disparity, score, rival : (N,) float64
        Best disparity, px, relative to `uv` rounded; its correlation; that of the best one elsewhere. Scores are -1
        where there is nothing to compare.
    """
    from ._patches import search_rows

    xy = np.rint(uv).astype(np.int64)
    shift = np.column_stack([-np.ceil(ranges[1]), -np.floor(ranges[0])]).astype(np.int64)
    found = np.empty((len(xy), 3))
    search_rows(first, second, xy, shift, patches.radius, patches.contrast, found)
    return -found[:, 0], found[:, 1], found[:, 2]


def refine(first: Plane, second: Plane, uv: FloatArray, start: FloatArray, patches: Patches) -> Alignment:
    """Disparity to a fraction of a pixel, by iterated least squares with affine brightness.

    With l the first patch and r the second, interpolated at the current disparity, and g the mean of their
    gradients along the row, ``l ≈ gain · (r + step · g) + offset`` is solved for the step until it vanishes (Lucas
    and Kanade 1981). Six-point interpolation keeps the result free of bias.

    Parameters
    ----------
    first, second : (H, W) float32
        Smoothed planes.
    uv : (N, 2) float64
        Points of the first image, px; patches are centred on the nearest pixel.
    start : (N,) float64
        Disparities ``u_first - u_second`` to start from, px.
    patches : Patches
        What to compare.

    Returns
    -------
    Alignment
    """
    from ._patches import align_rows

    found = np.empty((len(uv), 4))
    align_rows(first, second, np.rint(uv).astype(np.int64), -start, patches.radius, patches.contrast, found)
    return Alignment(-found[:, 0], found[:, 1], found[:, 2], found[:, 3] == 1)


def measure_vertical_offsets(
    first: Plane, second: Plane, uv: FloatArray, disparity: FloatArray, patches: Patches
) -> FloatArray:
    """``v_second - v_first`` of matches, by alignment in both directions.

    Measured on at most 128 of them, evenly chosen; those that do not converge within 3 rows are left out.

    Parameters
    ----------
    first, second : (H, W) float32
        Smoothed planes.
    uv : (N, 2) float64
        Positions in the first image, px.
    disparity : (N,) float64
        ``u_first - u_second``, px.
    patches : Patches
        Size of the patches that are compared.

    Returns
    -------
    (K,) float64
        px, of the K <= 128 that converged.
    """
    from ._patches import align_plane

    rows = np.arange(0, len(uv), max(1, -(-len(uv) // _MAX_OFFSETS)))
    xy = np.rint(uv[rows]).astype(np.int64)
    start, found = -disparity[rows], np.zeros((len(rows), 3))
    in_halves(
        lambda part: align_plane(first, second, xy[part], start[part], patches.radius, patches.contrast, found[part]),
        len(rows),
    )
    offsets: FloatArray = found[found[:, 2] == 1, 1]
    return offsets
