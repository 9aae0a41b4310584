"""Writers of calibration files, a program each; what a format cannot hold is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from .....errors import InputError
from .....types import LENSES, RawRig, Rig
from .colmap import colmap_files
from .kalibr import kalibr_files
from .opencv import opencv_files
from .ros import ros_files

OURS = "ours"


class Target(NamedTuple):
    """A format to write: the texts that it makes, by name, the lenses that it holds, and whether these are files."""

    files_of: Callable[[Rig | RawRig], dict[str, str]]
    lenses: tuple[str, ...]
    is_folder: bool = False


TARGETS = {
    "kalibr": Target(kalibr_files, ("brown", "equidistant", "double_sphere", "eucm", "mei")),
    "opencv": Target(opencv_files, ("brown", "rational", "thin_prism", "equidistant")),
    "ros": Target(ros_files, ("brown", "rational", "equidistant"), is_folder=True),
    "colmap": Target(colmap_files, ("brown", "rational", "equidistant"), is_folder=True),
}
"""Formats of other programs that a calibration can be written in."""


def calibration_files(cameras: Rig | RawRig, to: str) -> dict[str, str]:
    """Return the texts of a calibration in the format of another program, by the names of their files.

    What `read_calibration` makes of them has the same numbers: floats are written with all their digits. The
    last bits can differ where a format holds a number in another form: a baseline as its product with fx (OpenCV, ROS),
    a pose as rotations of both cameras (ROS) or as a quaternion, cx and cy moved by half a pixel (COLMAP). A lens
    whose further coefficients are all 0 is read as the simpler lens that it is.

    Parameters
    ----------
    cameras : Rig or RawRig
        The cameras; a rectified pair is written for Kalibr and COLMAP as two raw cameras without distortion.
    to : str
        ``"kalibr"``, ``"opencv"``, ``"ros"`` or ``"colmap"``.

    Returns
    -------
    dict of str

    Raises
    ------
    InputError
        If the format is not known, or cannot hold the cameras: a lens, a skew, a camera alone.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> list(calibration_files(rig, "ros"))
    ['left.yaml', 'right.yaml']
    """
    if to not in TARGETS:
        raise InputError(f"format is {repr(to)[:60]}, expected one of {', '.join(TARGETS)}")
    if isinstance(cameras, Rig):
        if not cameras.baseline:
            raise InputError(f"a single camera cannot be written for {to}, expected a pair, or --to {OURS}")
    else:
        for side, camera in (("left", cameras.left), ("right", cameras.right)):
            _check_lens(side, camera.lens, to)
    return TARGETS[to].files_of(cameras)


def _check_lens(side: str, lens: str, to: str) -> None:
    if lens not in TARGETS[to].lenses:
        able = [OURS, *(name for name, target in TARGETS.items() if lens in target.lenses)]
        named = f"{lens} ({', '.join(LENSES[lens])})"
        raise InputError(f"the {side} lens, {named}, cannot be written for {to}, expected --to {' or '.join(able)}")
