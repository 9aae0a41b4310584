"""The cameras: projection, back-projection, covariance, and what a usable pair is."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import check_luminance, check_pixels, require
from ..errors import InputError
from ..types import FloatArray, Rig, StereoPair, real_array

LARGEST_AREA = 64_000_000
LARGEST_SIDE = 32_767
_WIDEST_BASELINE = 5.0  # m, of a pair that a person or a car carries
_SHORTEST_FOCAL = 0.1  # of a side of the image: a field of view of 157 degrees, which no pinhole lens has
MIN_TOTAL = 1e-9  # px of disparity + doffs: farther points have no depth
_FARTHEST = 1e9  # px


def back_project(rig: Rig, uv: ArrayLike, disparity: ArrayLike) -> FloatArray:
    """Points seen at pixels of the left image with given disparities.

    ``z = fx · baseline / (disparity + doffs)``, ``y = z (v - cy) / fy``,
    ``x = z (u - cx - skew (v - cy) / fy) / fx``.

    Parameters
    ----------
    rig : Rig
        The cameras.
    uv : (N, 2) float array
        Pixels of the left image.
    disparity : (N,) float array
        ``u_left - u_right``, px; ``disparity + doffs`` must be positive (at least 1e-9).

    Returns
    -------
    (N, 3) float64
        Points in the left camera's frame, m.

    Raises
    ------
    InputError
        If the shapes do not fit, a value is not finite, or a depth is not positive.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> back_project(rig, [[320, 290]], [25]).tolist()
    [[0.0, 0.2, 2.0]]
    """
    pixels, total = _pixels_and_total(rig, uv, disparity)
    z = rig.fx * rig.baseline / total
    row = (pixels[:, 1] - rig.cy) / rig.fy
    column = (pixels[:, 0] - rig.cx - rig.skew * row) / rig.fx
    return np.column_stack([z * column, z * row, z])


def project(rig: Rig, xyz: ArrayLike) -> FloatArray:
    """Pixels of the left image where points are seen, eq. (2).

    Parameters
    ----------
    rig : Rig
        The cameras.
    xyz : (N, 3) float array
        Points in the left camera's frame, m.

    Returns
    -------
    (N, 2) float64
        px, also outside the image; NaN where z <= 0 or the point is not finite.

    Raises
    ------
    InputError
        If the shape is another one.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> project(rig, [[0, 0.2, 2], [0, 0, -1]]).tolist()
    [[320.0, 290.0], [nan, nan]]
    """
    require(rig, Rig, "project: rig")
    points = real_array(xyz, "project: xyz", "(N, 3)").astype(np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"project: xyz has shape {points.shape}, expected (N, 3)")
    seen = np.isfinite(points).all(axis=1) & (points[:, 2] > 0)
    x, y, z = np.where(seen[:, None], points, np.nan).T
    with np.errstate(over="ignore", invalid="ignore"):
        u = rig.cx + (rig.fx * x + rig.skew * y) / z
        v = rig.cy + rig.fy * y / z
    uv = np.column_stack([u, v])
    uv[~np.isfinite(uv).all(axis=1)] = np.nan
    return uv


def covariance(
    rig: Rig, uv: ArrayLike, disparity: ArrayLike, sigma: ArrayLike, *, sigma_disparity: ArrayLike | None = None
) -> FloatArray:
    """Covariance of back-projected points, ``Σ = J diag(σ², σ², σ²) Jᵀ``.

    J holds the derivatives of (x, y, z) by (u_left, u_right, v); where the disparity was measured by itself, by
    (u_left, disparity, v), and the second variance is its own.

    Parameters
    ----------
    rig : Rig
        The cameras.
    uv : (N, 2) float array
        Pixels of the left image.
    disparity : (N,) float array
        ``u_left - u_right``, px.
    sigma : (N,) array or float
        Standard deviation of each measured coordinate, px, not negative.
    sigma_disparity : (N,) array or float, optional
        Standard deviation of disparities that do not come from two places, px, positive or 0.

    Returns
    -------
    (N, 3, 3) float64
        m².

    Raises
    ------
    InputError
        As `back_project`, or if sigma is negative or not finite.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> np.sqrt(covariance(rig, [[320, 240]], [25], 0.5)[0, 2, 2]).round(6)
    np.float64(0.056569)
    """
    pixels, total = _pixels_and_total(rig, uv, disparity)
    spread = np.asarray(sigma, np.float64)
    if spread.shape not in ((), (len(pixels),)) or not np.all(np.isfinite(spread) & (spread >= 0)):
        raise InputError(f"covariance: sigma has shape {spread.shape}, expected {len(pixels)} finite values >= 0")
    J = _jacobian(rig, pixels, total)
    if sigma_disparity is None:
        scaled = J * np.reshape(spread, (-1, 1, 1))
    else:
        J[:, :, 0] += J[:, :, 1]  # now by u_left where the disparity stays
        own = np.broadcast_to(np.asarray(sigma_disparity, np.float64), len(pixels))
        if not np.all(np.isfinite(own) & (own >= 0)):
            raise InputError("covariance: sigma_disparity holds a value that is no spread, expected finite px >= 0")
        three = np.stack([np.broadcast_to(spread, len(pixels)), own, np.broadcast_to(spread, len(pixels))], axis=-1)
        scaled = J * three[:, None, :]
    return scaled @ scaled.transpose(0, 2, 1)


def _jacobian(rig: Rig, pixels: FloatArray, total: FloatArray) -> FloatArray:
    """Derivatives of (x, y, z) by (u_left, u_right, v); the disparity is u_left - u_right."""
    z = rig.fx * rig.baseline / total
    row = (pixels[:, 1] - rig.cy) / rig.fy
    column = (pixels[:, 0] - rig.cx - rig.skew * row) / rig.fx
    ray = np.column_stack([column, row, np.ones_like(z)])
    by_disparity = ray * (-z / total)[:, None]
    jacobian = np.zeros((len(z), 3, 3))
    jacobian[:, :, 0] = by_disparity
    jacobian[:, :, 1] = -by_disparity
    jacobian[:, 0, 0] += z / rig.fx
    jacobian[:, 0, 2] = -z * rig.skew / (rig.fx * rig.fy)
    jacobian[:, 1, 2] = z / rig.fy
    return jacobian


def _pixels_and_total(rig: Rig, uv: ArrayLike, disparity: ArrayLike) -> tuple[FloatArray, FloatArray]:
    require_baseline(rig, "back-projection")
    pixels = real_array(uv, "uv", "(N, 2)").astype(np.float64)
    shifts = real_array(disparity, "disparity", "(N,)").astype(np.float64)
    if pixels.ndim != 2 or pixels.shape[1] != 2 or shifts.shape != (len(pixels),):
        raise InputError(f"uv has shape {pixels.shape} and disparity {shifts.shape}, expected (N, 2) and (N,)")
    if not (np.isfinite(pixels).all() and np.isfinite(shifts).all()):
        raise InputError("uv or disparity holds values that are not finite, expected finite px")
    total = shifts + rig.doffs
    if np.any(total < MIN_TOTAL):
        row = int(np.argmin(total))
        raise InputError(f"disparity[{row}] + doffs is {total[row]:g} px, expected a positive number, at least 1e-9")
    if len(pixels) and np.abs(pixels).max() > _FARTHEST:
        raise InputError(f"uv holds {np.abs(pixels).max():g} px, expected at most {_FARTHEST:g}")
    return pixels, total


def doubts(rig: Rig) -> list[str]:
    """What looks wrong with a rig that can still be computed with.

    Parameters
    ----------
    rig : Rig
        The cameras.

    Returns
    -------
    list of str
        A line for each doubt.

    Examples
    --------
    >>> doubts(Rig(fx=500, fy=500, cx=320, cy=240, baseline=193.0, width=640, height=480))
    ['the baseline is 193 m: is it in millimetres? All depths would be 1000 times too large']
    """
    found = []
    if rig.baseline > _WIDEST_BASELINE:
        found.append(
            f"the baseline is {rig.baseline:g} m: is it in millimetres? All depths would be 1000 times too large"
        )
    for name, focal, side in (("fx", rig.fx, rig.width), ("fy", rig.fy, rig.height)):
        if focal < _SHORTEST_FOCAL * side:
            found.append(
                f"{name} is {focal:g} px, for {side} px of the image: is it in millimetres, or a share of them?"
            )
            break
    if not (0 <= rig.cx < rig.width and 0 <= rig.cy < rig.height):
        found.append(f"the principal point ({rig.cx:g}, {rig.cy:g}) px lies outside of {rig.width} x {rig.height} px")
    return found


def require_baseline(rig: Rig, what: str, why: str = "z = fx · baseline / disparity") -> None:
    """Raise `InputError` where a disparity needs a depth, or a depth a disparity, and the rig is a single camera.

    Parameters
    ----------
    rig : Rig
        The cameras.
    what : str
        How the error begins.
    why : str
        What the baseline is needed for.
    """
    require(rig, Rig, f"{what}: rig")
    if not rig.baseline > 0:
        raise InputError(f"{what}: the rig has no baseline (a single camera), expected one, m: {why}")


def check_pair(pair: StereoPair) -> None:
    """Check that a pair can be worked on.

    Parameters
    ----------
    pair : StereoPair
        Images of one size and dtype, uint8, uint16 or float in [0, 1], grey or RGB, as large as the rig says, which has
        a baseline; a finite stamp; where it says which pixels are valid, as many of these.

    Raises
    ------
    InputError
        If not; the message names the pair, what differs and what was expected.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=32, cy=24, baseline=0.1, width=64, height=48)
    >>> check_pair(StereoPair(np.zeros((48, 64), np.uint8), np.zeros((48, 64), np.uint8), rig))
    """
    require(pair, StereoPair, "pair")
    require_baseline(pair.rig, pair.name)
    if not isinstance(pair.stamp, int | float | np.number) or not np.isfinite(pair.stamp):
        raise InputError(f"{pair.name}: its stamp is {repr(pair.stamp)[:40]}, expected seconds")
    for side, image in (("left", pair.left), ("right", pair.right)):
        check_image(f"{pair.name}: {side} image", image)
    left, right = pair.left, pair.right
    if left.shape[:2] != right.shape[:2]:
        raise InputError(f"{pair.name}: left image is {_size(left)}, right {_size(right)}, expected the same size")
    if left.ndim != right.ndim:
        kinds = ["grey" if image.ndim == 2 else "in colour" for image in (left, right)]
        wanted = "both alike (magick IN.png -colorspace Gray OUT.png makes a grey one)"
        raise InputError(f"{pair.name}: left image is {kinds[0]}, right {kinds[1]}, expected {wanted}")
    if left.dtype != right.dtype:
        raise InputError(f"{pair.name}: left image is {left.dtype}, right {right.dtype}, expected the same dtype")
    if left.shape[:2] != (pair.rig.height, pair.rig.width):
        raise InputError(
            f"{pair.name}: images are {_size(left)}, but the calibration is for {pair.rig.width} x {pair.rig.height} px"
        )
    _check_valid(pair)


def _check_valid(pair: StereoPair) -> None:
    """Refuse a mask of pixels that is none of this rig's."""
    valid, shape = pair.valid, (pair.rig.height, pair.rig.width)
    if valid is None:
        return
    if not isinstance(valid, np.ndarray) or valid.dtype != np.bool_ or valid.shape != shape:
        found = f"{valid.dtype} of shape {valid.shape}" if isinstance(valid, np.ndarray) else repr(valid)[:40]
        raise InputError(f"{pair.name}: valid is {found}, expected bool of shape {shape}")


def check_image(what: str, image: NDArray[Any]) -> None:
    """Raise `InputError` unless an image is grey or RGB, of a known type, not too large, and in its range.

    Parameters
    ----------
    what : str
        How the error begins.
    image : (H, W) or (H, W, 3) uint8, uint16 or float array
        Floats in [0, 1].
    """
    check_pixels(what, image)
    if image.ndim == 3 and image.shape[2] != 3:
        raise InputError(f"{what} has shape {image.shape}, expected (H, W) or (H, W, 3)")
    height, width = image.shape[:2]
    if max(height, width) > LARGEST_SIDE or height * width > LARGEST_AREA:
        raise InputError(f"{what} is {_size(image)}, expected at most {LARGEST_SIDE} a side and {LARGEST_AREA} in all")
    check_luminance(what, image)


def _size(image: NDArray[Any]) -> str:
    colour = " in colour" if image.ndim == 3 else ""
    return f"{image.shape[1]} x {image.shape[0]} px{colour}"
