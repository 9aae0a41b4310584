"""Cameras that are plugged in: opened, and what they give."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from .._files import bad_input, one_line
from ..errors import InputError
from ..types import RawRig, Rig
from ._stereo_layouts import LAYOUTS, check_layout
from ._video import silence


class Capture(Protocol):
    """What a camera is read by: the part of OpenCV's ``VideoCapture`` that is used."""

    def grab(self) -> bool:
        """Take the next image.

        Returns
        -------
        bool
            False where there is none.
        """

    def retrieve(self) -> tuple[bool, Any]:
        """Give the image that was taken.

        Returns
        -------
        tuple of bool and (H, W, 3) or (H, W) uint8
            Whether there is one; it is BGR or grey.
        """

    def release(self) -> None:
        """Let go of the camera."""


def open_camera(camera: int | str, size: tuple[int, int]) -> Capture:
    """Open a camera by OpenCV and ask it for images of a size.

    Parameters
    ----------
    camera : int or str
        Its number, or its device.
    size : tuple of 2 int
        Width and height, px; it may give others.

    Returns
    -------
    Capture

    Raises
    ------
    InputError
        If it cannot be opened.
    """
    import cv2

    kind = cv2.CAP_V4L2 if sys.platform.startswith("linux") else cv2.CAP_ANY
    with silence():
        try:
            capture = cv2.VideoCapture(camera, kind)
        except cv2.error:
            capture = cv2.VideoCapture()
        if not capture.isOpened():
            said = "cannot be opened as a camera"
            raise bad_input(f"camera {camera}", said, "a number, such as 0, or a device that no other program uses")
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
    return capture


def ids_of(cameras: int | str | Sequence[int | str], layout: str | None) -> list[int | str]:
    """Number or device of one camera or of two; a layout goes with one."""
    given = [cameras] if isinstance(cameras, int | str) else list(cameras)
    check_layout(layout)
    if len(given) not in (1, 2):
        raise InputError(f"cameras has {len(given)}, expected one, or a left and a right one")
    if len(given) == 2 and layout is not None:
        raise InputError(f"layout is {layout!r} beside two cameras, expected none: each is one side")
    if len(given) == 1 and (layout is None or layout not in LAYOUTS[:2]):
        wanted = " or ".join(map(repr, LAYOUTS[:2]))
        raise InputError(f"layout is {layout!r}, expected {wanted} of one camera, or two cameras")
    ids = [int(each) if isinstance(each, str) and each.isascii() and each.isdigit() else each for each in given]
    if len(set(ids)) < len(ids):
        raise InputError(one_line(f"cameras are {ids[0]} and {ids[1]}, expected two"))
    return ids


def frame_size(cameras: Rig | RawRig, layout: str | None) -> tuple[int, int]:
    """Size of what one camera gives, px."""
    one = cameras.left if isinstance(cameras, RawRig) else cameras
    return one.width * (1 + (layout == "side-by-side")), one.height * (1 + (layout == "over-under"))


def open_all(
    ids: Sequence[int | str], size: tuple[int, int], open_capture: Callable[[int | str, tuple[int, int]], Capture]
) -> list[Capture]:
    """Open all cameras, or none."""
    opened: list[Capture] = []
    try:
        for each in ids:
            opened.append(open_capture(each, size))
    except BaseException:
        for capture in opened:
            capture.release()
        raise
    return opened


def is_image(image: Any) -> bool:
    """Whether a camera gave an image, grey or B, G, R, of 8 bits."""
    is_array = isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.size > 0
    return is_array and (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3))
