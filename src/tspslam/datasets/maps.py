"""An image with a map of its depths or disparities, as RGB-D cameras and networks give them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .._files import PathLike, bad_input, one_line
from ..errors import InputError
from ..io.images import LARGEST_AREA, read_image
from ..io.npy import read_npy
from ..types import StereoPair
from ..vision.dense import checked_map, checked_unit, disparity_of_depth
from ..vision.formats import read_rectified
from ..vision.rig import check_pair, require_baseline

_EXPECTED = "a map (H, W): a 16-bit PNG or TIFF, or a .npy of numbers"


def pair_from_map(
    image: PathLike,
    map_: PathLike,
    calib: PathLike,
    *,
    kind: Literal["depth", "disparity"] = "depth",
    unit: float | None = None,
) -> StereoPair:
    """Read an image and a map of its depths or disparities.

    Parameters
    ----------
    image : str or path
        What the left camera saw, rectified.
    map_ : str or path
        Depths or disparities of its pixels: a 16-bit PNG or TIFF, or a ``.npy`` file.
    calib : str or path
        Calibration, as `tspslam.read_calibration` reads it; for a camera without a second eye any baseline will do.
    kind : {"depth", "disparity"}
        What the map holds.
    unit : float, optional
        Metres, or px, in one step of the map; whole numbers need it (0.001 for mm, 1/256 for KITTI's disparities).

    Returns
    -------
    StereoPair
        With `disparity`; its right image is the left one.

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
    pixels = read_image(image)
    rig = read_rectified(calib, (pixels.shape[1], pixels.shape[0]))
    require_baseline(rig, f"{calib}", "for a depth map any will do, such as 0.1; it sets the covariance")
    values = read_map(map_)
    try:
        if kind == "depth":
            disparity = disparity_of_depth(rig, values, unit=unit)
        else:
            disparity = checked_map("disparity", _scaled(values, unit), rig)
    except InputError as error:
        raise InputError(f"{map_}: {error}") from error
    pair = StereoPair(pixels, pixels, rig, name=one_line(Path(image).stem), disparity=disparity)
    check_pair(pair)
    return pair


def read_map(path: PathLike) -> NDArray[Any]:
    """Read a map of numbers, (H, W), from an image of one channel or a ``.npy`` file.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    (H, W) array
        Of the file's own type: whole numbers or floats.

    Raises
    ------
    InputError
        If it cannot be read, is no plane of numbers, or larger than 64 megapixels.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.save(f"{folder}/depth.npy", np.ones((2, 3)))
    ...     read_map(f"{folder}/depth.npy").shape
    (2, 3)
    """
    values = read_npy(path, _EXPECTED, LARGEST_AREA) if Path(path).suffix.lower() == ".npy" else read_image(path)
    if values.ndim != 2 or values.dtype.kind not in "iuf":
        raise bad_input(path, f"holds {values.dtype} of shape {values.shape}", _EXPECTED)
    return values


def _scaled(values: NDArray[Any], unit: float | None) -> NDArray[Any]:
    """Disparities in px; whole numbers need a unit, and 0 is unknown in them."""
    if values.dtype.kind == "f" and unit is None:
        return values
    if unit is None:
        raise InputError(f"disparity map is {values.dtype} without a unit, expected px in one step, such as 1/256")
    with np.errstate(over="ignore"):
        scaled = values.astype(np.float64) * checked_unit(unit)
    return np.where(values == 0, np.nan, scaled) if values.dtype.kind in "iu" else scaled
