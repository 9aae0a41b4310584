"""What every reader returns, and how it is put together from values that know their origin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ....errors import InputError
from ....types import LENSES, Camera, FloatArray, RawRig, Rig
from ._source import Source
from ._values import Found

Remarks = tuple[str, ...]


@dataclass(frozen=True)
class Calibration:
    """Cameras read from a file, and where in the file each value comes from.

    Attributes
    ----------
    cameras : Rig or RawRig
        A rectified pair, or two cameras as they were calibrated.
    format : str
        What kind of file it is, such as ``"Kalibr camchain"``.
    origin : dict of str
        For each value that was read, named as in `Rig` or as ``left.fx``, ``right.k1``, ``T_right_left``: the keys of
        the file, such as ``"P1[0,3] / -P1[0,0]"``. A value that the file leaves out is 0 and is not listed.
    remarks : tuple of str
        Remarks for the user, a line each.
    disparity_range : tuple of 2 floats or None
        Smallest and largest disparity of the scene, px, where the file tells them, as Middlebury's do.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> Calibration(rig, "by hand", {"fx": "fx"}).origin["fx"]
    'fx'
    """

    cameras: Rig | RawRig
    format: str
    origin: dict[str, str]
    remarks: Remarks = ()
    disparity_range: tuple[float, float] | None = None


def rectified(found: Found, kind: str, remarks: Remarks = ()) -> Calibration:
    """Return a rectified pair from its values."""
    numbers: dict[str, Any] = {name: value for name, (value, _) in found.items()}
    return Calibration(Rig(**numbers), kind, {name: key for name, (_, key) in found.items()}, remarks)


def raw(
    source: Source, sides: tuple[Found, Found], pose: tuple[FloatArray, str], kind: str, remarks: Remarks = ()
) -> Calibration:
    """Return a raw pair from the values of its left and right camera, and T_right_left with its origin."""
    T_right_left, origin_of_pose = pose
    _check_sizes(source, *sides)
    _check_side_by_side(source, T_right_left, origin_of_pose)
    try:
        left, right = (camera_of(found) for found in sides)
        cameras = RawRig(left, right, tuple((a, b, c, d) for a, b, c, d in T_right_left.tolist()))
    except InputError as error:
        raise source.error(str(error)) from error
    named = zip(("left", "right"), sides, strict=True)
    origin = {f"{side}.{name}": key for side, found in named for name, (_, key) in found.items()}
    return Calibration(cameras, kind, origin | {"T_right_left": origin_of_pose}, remarks)


def camera_of(found: Found) -> Camera:
    """The camera of its values; `lens` among them names the model where it is not Brown's."""
    values: dict[str, Any] = {name: value for name, (value, _) in found.items()}
    lens = values.pop("lens", "brown")
    coefficients = tuple(values.pop(name, 0.0) for name in LENSES[lens])
    return Camera(**values, distortion=coefficients, lens=lens)


def _check_sizes(source: Source, left: Found, right: Found) -> None:
    for name in ("width", "height"):
        (one, key), (other, other_key) = left[name], right[name]
        if one != other:
            raise source.error(f"image {name}: {key} is {one}, {other_key} is {other}, expected the same size")


def _check_side_by_side(source: Source, T_right_left: FloatArray, origin: str) -> None:
    centre = -T_right_left[:3, :3].T @ T_right_left[:3, 3]
    if centre[0] > abs(centre[1]):
        return
    where = f"({', '.join(f'{c:.6g}' for c in centre)}) m"
    swapped = np.linalg.norm(centre) > 0 and -centre[0] > abs(centre[1])
    hint = "left and right look swapped" if swapped else "the cameras are not side by side"
    raise source.error(
        f"by {origin} the right camera is at {where} in the left one's frame, expected x > |y| of it: {hint}"
    )
