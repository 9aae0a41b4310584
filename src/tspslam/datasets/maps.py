"""An image with a map of its depths or disparities, as RGB-D cameras and networks give them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from numpy.typing import NDArray

from .._files import PathLike, bad_input, one_line
from ..errors import InputError
from ..io.images import LARGEST_AREA, read_image, read_numbers
from ..io.npy import read_npy
from ..types import Image, StereoPair
from ..vision.calibration.formats import read_rectified
from ..vision.rig import check_pair, require_baseline
from ..vision.stereo.dense import checked_map, checked_unit, disparity_of_depth, known_values, unknown_values
from ._levels import Levels

_EXPECTED = "a map (H, W): a 16-bit PNG or TIFF, a float32 TIFF, PFM or OpenEXR, or a .npy of numbers"


def pair_from_map(
    image: PathLike,
    map_: PathLike,
    calib: PathLike,
    *,
    kind: Literal["depth", "disparity"] = "depth",
    unit: float | None = None,
    unknown: float | None = None,
    bits: int | None = None,
) -> StereoPair:
    """Read an image and a map of its depths or disparities.

    Parameters
    ----------
    image : str or path
        What the left camera saw, rectified.
    map_ : str or path
        Depths or disparities of its pixels: a 16-bit PNG or TIFF, a float32 TIFF, PFM or OpenEXR, or a ``.npy`` file.
    calib : str or path
        Calibration, as `tspslam.read_calibration` reads it; for depths of a single camera any baseline
        will do.
    kind : {"depth", "disparity"}
        What the map holds.
    unit : float, optional
        Metres, or px, in one step of the map; whole numbers need it (0.001 for mm, 1/256 for KITTI's disparities).
    unknown : float, optional
        Value of the file that stands for "not known", besides 0 in whole numbers, NaN and infinity (give NaN for no
        other one). By default those at an end of the range that are too common to be measured, such as 65535 or
        OpenCV's -16.
    bits : int, optional
        How many bits the image's pixels use if they have 16; found by default.

    Returns
    -------
    StereoPair
        With `disparity`, and the values found to be unknown in `unknown`; its right image is the left one.

    Raises
    ------
    InputError
        If a file cannot be read, sizes do not fit, or the unit is missing or cannot be right.

    Examples
    --------
    >>> pair_from_map("no-such-left.png", "depth.png", "calib.yaml")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-left.png: cannot be opened (No such file or directory); expected a PNG, ...
    """
    pixels, used = read_levelled(image, bits)
    rig = read_rectified(calib, (pixels.shape[1], pixels.shape[0]))
    if kind == "depth":
        require_baseline(rig, f"{calib}", "for a depth map any will do, such as 0.1; it sets the covariance")
    require_baseline(rig, f"{calib}")
    values = read_map(map_)
    try:
        _check_unit(kind, values, unit)
        if unknown is not None and unit is not None:
            _refuse_scaled(values, unknown, checked_unit(unit))
        found = unknown_values(values[values > 0] if kind == "depth" else values) if unknown is None else ()
        known = known_values(values, found if unknown is None else (unknown,))
        if kind == "depth":
            disparity = disparity_of_depth(rig, known, unit=unit)
        else:
            disparity = checked_map("disparity", known * checked_unit(unit), rig)
    except InputError as error:
        raise InputError(f"{map_}: {error}") from error
    name = one_line(Path(image).stem)
    pair = StereoPair(pixels, pixels, rig, name=name, disparity=disparity, bits=used, unknown=found)
    check_pair(pair)
    return pair


def read_levelled(path: PathLike, bits: int | None = None) -> tuple[Image, int | None]:
    """Read an image, its 16-bit pixels moved up to fill their range, and how many bits they used.

    Parameters
    ----------
    path : str or path
        The image file.
    bits : int, optional
        How many bits its pixels use; found by default.

    Returns
    -------
    image : (H, W) or (H, W, 3) uint8 or uint16
        The pixels, moved up to the full range.
    bits : int or None
        None for 8-bit pixels.

    Raises
    ------
    InputError
        If it cannot be read, or the bits do not fit it.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from tspslam.io import write_png
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_png(f"{folder}/grey.png", np.array([[0, 1000]], np.uint16))
    ...     image, bits = read_levelled(f"{folder}/grey.png", 12)
    >>> image.tolist(), bits
    ([[0, 16000]], 12)
    """
    image = read_image(path)
    levels = Levels(lambda _: [image], 1, bits)
    try:
        return levels([image])[0], levels.bits_of(image)
    except InputError as error:
        raise InputError(f"{one_line(str(path))}: {error}") from error


def read_map(path: PathLike) -> NDArray[Any]:
    """Read a map of numbers, (H, W), from an image of one channel (PNG, TIFF, PGM, PFM, OpenEXR) or a ``.npy`` file.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    (H, W) integers or floats
        Of the file's own type.

    Raises
    ------
    InputError
        If it cannot be read, is no plane of numbers, or larger than 64 megapixels.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.save(f"{folder}/depth.npy", np.ones((2, 3)))
    ...     read_map(f"{folder}/depth.npy").shape
    (2, 3)
    """
    is_npy = Path(path).suffix.lower() == ".npy"
    values = read_npy(path, _EXPECTED, LARGEST_AREA) if is_npy else read_numbers(path, _EXPECTED)
    if values.ndim != 2 or values.dtype.kind not in "iuf":
        raise bad_input(path, f"holds {values.dtype} of shape {values.shape}", _EXPECTED)
    return values


def _refuse_scaled(values: NDArray[Any], unknown: float, unit: float) -> None:
    """Refuse a value in metres or px for "not known" that only the steps of the map would be."""
    step = round(unknown / unit) if abs(unknown) < 1e9 and values.dtype.kind in "iu" else unknown
    if step != unknown and not (values == unknown).any() and (values == step).any():
        raise InputError(f"unknown is {unknown:g}, which is not in the map; expected its own step, {step:g}")


def _check_unit(kind: str, values: NDArray[Any], unit: float | None) -> None:
    """Whole numbers need a unit."""
    example = "metres in one step, such as 0.001 for mm" if kind == "depth" else "px in one step, such as 1/256"
    if values.dtype.kind in "iu" and unit is None:
        raise InputError(f"{kind} map is {values.dtype} without a unit, expected {example}")
