"""Lists of images for a store: a text file with a line an image."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..._files import PathLike, bad_input
from ..._text import numbers, read_lines, split
from ...errors import InputError
from ...io import image_size
from ...types import FloatArray
from ...vision.calibration.formats import read_rectified
from ...vision.se3 import normalised
from .images import ImageReference

_EXPECTED = (
    "lines IMAGE U V (place of its pixel (0, 0)) or IMAGE CALIBRATION and 12 numbers (pose in the world, row by row)"
)
_PLANE, _CAMERA = 3, 14  # words in a line
_DIGITS = 1e-3  # what a rotation in a text may be off by, as in other files


def read_images(path: PathLike) -> list[ImageReference]:
    r"""Read a list of images: ``IMAGE U V``, or ``IMAGE CALIBRATION r11 r12 r13 tx r21 ... tz``; # begins a comment.

    Parameters
    ----------
    path : str or path
        The text file; names in it are from its folder on, and hold no blanks.

    Returns
    -------
    list of ImageReference

    Raises
    ------
    InputError
        If a line is another, a pose is no rigid motion to 1e-3, or an image or a calibration cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "images.txt").write_text("tile-0.png 0 0\ntile-1.png 1000 0\n")
    ...     [image.origin for image in read_images(f"{folder}/images.txt")]
    [(0.0, 0.0), (1000.0, 0.0)]
    """
    folder, found = Path(path).parent, []
    for line in read_lines(path, _EXPECTED):
        if not line[1]:
            continue
        words = split(path, line, _EXPECTED, (_PLANE, _CAMERA))
        image = os.fspath(folder / words[0])
        try:
            if len(words) == _PLANE:
                u, v = numbers(path, line, words[1:], _EXPECTED)
                found.append(ImageReference(image, origin=(u, v)))
            else:
                pose = np.eye(4)
                pose[:3] = np.reshape(numbers(path, line, words[2:], _EXPECTED), (3, 4))
                rig = read_rectified(folder / words[1], image_size(image))
                found.append(ImageReference(image, rig, _rounded(pose)))
        except InputError as error:
            raise (
                error if str(path) in str(error) else bad_input(path, f"line {line[0]}: {error}", _EXPECTED)
            ) from error
    if not found:
        raise bad_input(path, "names no image", _EXPECTED)
    return found


def _rounded(pose: FloatArray) -> FloatArray:
    """A pose whose rotation is exact, of one with the digits of a text."""
    if not np.isfinite(pose).all() or np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > _DIGITS:
        raise InputError(f"has no rotation to {_DIGITS:g} in its pose")
    return normalised(pose)
