"""Points from a disparity or depth map: RGB-D cameras, block matching, networks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._checks import refuse_path
from ...errors import GeometryError, InputError
from ...types import Cloud, FloatArray, Rig
from ..rig import MIN_TOTAL, back_project, covariance, require_baseline

_SMOOTH = 1.0  # px of disparity between neighbouring pixels; more is an edge, across which nothing is interpolated
_FARTHEST_MEDIAN = 1000.0  # m; a map whose median lies beyond is in another unit
# A value at an end of a map's range that stands for "not known" shows in how common it is. OpenCV's block matching on
# the Motorcycle pair: 13 to 45 % of the pixels, and 10 to 140 times the most common value between the ends.
_DOMINANT_SHARE, _DOMINANT = 0.01, 4.0
_FEWEST_LEVELS = 16  # values between the ends; fewer (a wall and a box) do not tell how common a value is
_SIGNS = (-1.0, -16.0)  # of OpenCV's block matching, in px and in its sixteenths, where nothing else is negative


def cloud_from_disparity(
    rig: Rig, disparity: ArrayLike, uv: ArrayLike, *, sigma: ArrayLike = 0.5, sigma_map: ArrayLike | None = None
) -> Cloud:
    """Points at given places of a disparity map.

    Parameters
    ----------
    rig : Rig
        The cameras.
    disparity : (H, W) float array
        ``u_left - u_right`` at each pixel of the left image, px; NaN, infinite, or without positive depth where it is
        not known.
    uv : (N, 2) float array
        Places in the left image, px: keypoints, or `GridDetector`'s.
    sigma : (N,) array or float
        Standard deviation of u_left, u_right and v, px.
    sigma_map : (H, W) float array, optional
        Standard deviation of the disparity of each pixel, px, where it is known; then `sigma` is that of u and v.

    Returns
    -------
    Cloud
        In the order of `uv`, without the places whose disparity is not known.

    Raises
    ------
    InputError
        If the map has another size than the rig or is not of floats, or `uv` is no array of places in the image.
    GeometryError
        If the map knows none of the places.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> cloud_from_disparity(rig, np.full((480, 640), 25.0), [[320, 290]]).xyz.tolist()
    [[0.0, 0.2, 2.0]]
    """
    require_baseline(rig, "disparity map")
    known = _possible(checked_map("disparity", disparity, rig), rig)
    places = _array("uv", uv)
    if places.dtype.kind not in "iuf":
        raise InputError(f"uv is {places.dtype}, expected numbers")
    places = places.astype(np.float64)
    if places.ndim != 2 or places.shape[1] != 2:
        raise InputError(f"uv has shape {places.shape}, expected (N, 2)")
    if len(places) and not ((places >= 0) & (places <= (rig.width - 1, rig.height - 1))).all():
        raise InputError(f"uv holds places outside of {rig.width} x {rig.height} px, expected all inside the image")
    found = sample_map(np.where(known + rig.doffs >= MIN_TOTAL, known, np.nan), places)
    rows = np.flatnonzero(np.isfinite(found))
    if len(rows) == 0:
        behind = " (values are negative: left and right look swapped)" if np.any(known + rig.doffs < 0) else ""
        raise GeometryError(f"the map knows the disparity of none of {len(places)} places{behind}, expected some")
    spread = _array("sigma", sigma)
    if spread.shape not in ((), (len(places),)) or spread.dtype.kind not in "iuf":
        raise InputError(f"sigma is {spread.dtype} of shape {spread.shape}, expected one number or {len(places)}")
    spread = np.broadcast_to(spread.astype(np.float64), len(places))[rows]
    uv, disparity = places[rows], found[rows]
    own = None if sigma_map is None else sample_sigma(checked_map("sigma", sigma_map, rig), uv, float(np.max(spread)))
    return Cloud(
        back_project(rig, uv, disparity), uv, disparity, covariance(rig, uv, disparity, spread, sigma_disparity=own)
    )


def cloud_from_depth(
    rig: Rig, depth: ArrayLike, uv: ArrayLike, *, unit: float | None = None, sigma: ArrayLike = 0.5
) -> Cloud:
    """Points at given places of a depth map, as `cloud_from_disparity`.

    Parameters
    ----------
    rig : Rig
        The camera; any baseline will do for a single camera, and sets the covariance.
    depth : (H, W) float array
        z at each pixel; 0, NaN or infinite, or the largest of a type of whole numbers (65535), where it is not known.
    uv : (N, 2) float array
        Places in the image, px.
    unit : float, optional
        Metres in one step of `depth`: 0.001 for millimetres. Whole numbers need it; floats are metres by default.
    sigma : (N,) array or float
        Standard deviation of u_left, u_right and v, px.

    Returns
    -------
    Cloud

    Raises
    ------
    InputError
        As `cloud_from_disparity`; also if the unit is missing, or the median depth is over 1000 m.
    GeometryError
        As `cloud_from_disparity`.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> cloud_from_depth(rig, np.full((480, 640), 2000, np.uint16), [[320, 290]], unit=0.001).xyz.tolist()
    [[0.0, 0.2, 2.0]]
    """
    return cloud_from_disparity(rig, disparity_of_depth(rig, depth, unit=unit), uv, sigma=sigma)


def disparity_of_depth(rig: Rig, depth: ArrayLike, *, unit: float | None = None) -> FloatArray:
    """Disparity map of a depth map, ``fx · baseline / z - doffs``; NaN where the depth is not known.

    Parameters, errors: as `cloud_from_depth`.

    Returns
    -------
    (H, W) float64
        px.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=1, cy=0, baseline=0.1, width=2, height=1)
    >>> disparity_of_depth(rig, [[2.0, 0.0]]).tolist()
    [[25.0, nan]]
    """
    require_baseline(rig, "depth map", "for a depth camera any will do, such as 0.1; it sets the covariance")
    values = _array("depth map", depth)
    if values.dtype.kind in "iu" and unit is None:
        raise InputError(f"depth map is {values.dtype} without a unit, expected unit=0.001 for millimetres, say")
    scale = checked_unit(unit)
    if values.dtype.kind in "iu":
        values = known_values(values, (float(np.iinfo(values.dtype).max),))
    z = checked_map("depth", values, rig) * scale
    z = np.where(z >= 1e-9, z, np.nan)
    median = float(np.nanmedian(z)) if np.isfinite(z).any() else 0.0
    if median > _FARTHEST_MEDIAN:
        raise InputError(f"depth map has a median of {median:.4g} m, expected metres; unit=0.001 reads millimetres")
    return rig.fx * rig.baseline / z - rig.doffs


def unknown_values(values: NDArray[Any]) -> tuple[float, ...]:
    """Values at the ends of a map's range that stand for "not known", besides 0 in whole numbers.

    An end is one if it is the largest of its type of whole numbers, or -1 or -16 where nothing else is negative, or if
    1 % of the pixels have it and four times as many as have any value between the ends.

    Parameters
    ----------
    values : (H, W) float array
        Depths or disparities as they were written, whole numbers or floats.

    Returns
    -------
    tuple of float
        None, one or two, ascending.

    Examples
    --------
    >>> unknown_values(np.array([[-16, 320, 336]], np.int16))
    (-16.0,)
    >>> unknown_values(np.array([[-32, -16, 336]], np.int16))
    ()
    """
    known = values[np.isfinite(values)]
    known = known[known != 0] if values.dtype.kind in "iu" else known
    levels, count = np.unique(known, return_counts=True)
    if len(levels) < 2:
        return ()
    between = count[1:-1]
    often = max(_DOMINANT_SHARE * values.size, _DOMINANT * between.max(initial=0))
    ends = {0, len(levels) - 1}
    found = {end for end in ends if len(between) >= _FEWEST_LEVELS and count[end] >= often}
    if levels[0] in _SIGNS and levels[1] >= 0:
        found.add(0)
    if values.dtype.kind in "iu" and levels[-1] in (65_535, np.iinfo(values.dtype).max):
        found.add(len(levels) - 1)
    return tuple(float(levels[end]) for end in sorted(found))


def known_values(values: NDArray[Any], unknown: Sequence[float]) -> FloatArray:
    """A map as float64, NaN where it is one of `unknown`, or 0 in whole numbers.

    Parameters
    ----------
    values : (H, W) numbers
        The map.
    unknown : sequence of float
        Values that mean "not known".

    Returns
    -------
    (H, W) float64
    """
    is_unknown = values == 0 if values.dtype.kind in "iu" else np.zeros(values.shape, bool)
    for value in unknown:
        is_unknown |= values == np.asarray(value, values.dtype if values.dtype.kind == "f" else np.float64)
    with np.errstate(over="ignore"):
        return np.where(is_unknown, np.nan, values.astype(np.float64))


def checked_unit(unit: float | None) -> float:
    """Return how much one step of a map is, or raise `InputError`.

    Parameters
    ----------
    unit : float or None
        1e-9 to 1e9; None is 1.

    Returns
    -------
    float
    """
    if unit is None:
        return 1.0
    if isinstance(unit, bool) or not isinstance(unit, int | float | np.number) or not 1e-9 <= unit <= 1e9:
        raise InputError(f"unit is {repr(unit)[:40]}, expected how much one step of the map is, such as 0.001")
    return float(unit)


def checked_map(what: str, values: ArrayLike, rig: Rig) -> FloatArray:
    """Return a map as float64, NaN where it is not finite, or raise `InputError`.

    Parameters
    ----------
    what : str
        How the error begins.
    values : (H, W) float array
        The map.
    rig : Rig
        Its size is the map's.

    Returns
    -------
    (H, W) float64
    """
    array = _array(f"{what} map", values)
    if array.shape != (rig.height, rig.width):
        size = " x ".join(map(str, array.shape[::-1]))
        raise InputError(f"{what} map is {size}, expected {rig.width} x {rig.height} px, the image's size")
    if array.dtype.kind != "f":
        raise InputError(f"{what} map is {array.dtype}, expected floats")
    with np.errstate(over="ignore"):
        values64 = array.astype(np.float64)
    return np.where(np.abs(values64) < 1e100, values64, np.nan)  # farther than any, and no product overflows


def _array(what: str, values: ArrayLike) -> NDArray[Any]:
    refuse_path(values, what, "an array", "tspslam.datasets.read_map(path)")
    try:
        return np.asarray(values)
    except ValueError as error:
        raise InputError(f"{what} has rows of different lengths, expected an array") from error


def _possible(disparity: FloatArray, rig: Rig) -> FloatArray:
    """Disparities up to the image's width; others are unknown, unless they are most: then the unit is another."""
    known, beyond = np.isfinite(disparity).sum(), disparity > rig.width
    if 2 * beyond.sum() > known:
        most = float(np.nanmedian(disparity))
        raise InputError(f"disparity map has a median of {most:.4g} px, expected at most the width, {rig.width} px")
    return np.where(beyond, np.nan, disparity)


def sample_map(disparity: FloatArray, uv: FloatArray) -> FloatArray:
    """Disparity at places of a map: bilinear on smooth ground, of the nearest pixel at edges; NaN where not known.

    Parameters
    ----------
    disparity : (H, W) float64
        px; NaN where it is not known.
    uv : (N, 2) float64
        Places inside the image, px.

    Returns
    -------
    (N,) float64

    Examples
    --------
    >>> sample_map(np.array([[1.0, 2.0, 9.0]]), np.array([[0.5, 0], [1.4, 0]])).tolist()
    [1.5, 2.0]
    """
    height, width = disparity.shape
    left, top = (np.minimum(uv[:, k].astype(np.int64), max(size - 2, 0)) for k, size in ((0, width), (1, height)))
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    corners = np.stack([disparity[top, left], disparity[top, right], disparity[bottom, left], disparity[bottom, right]])
    a, b = uv[:, 0] - left, uv[:, 1] - top
    weights = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b])
    nearest = np.take_along_axis(corners, weights.argmax(axis=0)[None], axis=0)[0]
    is_smooth = corners.max(axis=0) - corners.min(axis=0) <= _SMOOTH  # False where one is NaN
    return np.where(is_smooth, (weights * corners).sum(axis=0), nearest)


def sample_sigma(sigma: FloatArray, uv: FloatArray, otherwise: float) -> FloatArray:
    """Standard deviation of the disparity at places of a map: that of the nearest pixel.

    Parameters
    ----------
    sigma : (H, W) float64
        px; NaN or not positive where it is not known.
    uv : (N, 2) float64
        Places inside the image, px.
    otherwise : float
        What it is where the map does not tell, px.

    Returns
    -------
    (N,) float64

    Examples
    --------
    >>> sample_sigma(np.array([[0.1, np.nan]]), np.array([[0.4, 0], [0.6, 0]]), 0.3).tolist()
    [0.1, 0.3]
    """
    column, row = np.floor(uv.T + 0.5).astype(np.int64)
    height, width = sigma.shape
    found = sigma[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)].astype(np.float64)
    with np.errstate(invalid="ignore"):
        return np.where((found > 0) & (found < np.inf), found, otherwise)
