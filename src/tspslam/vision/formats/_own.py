"""Our own calibration file, among the others'."""

from __future__ import annotations

from dataclasses import fields

from ...types import Camera, RawRig, Rig
from ..calibration import load_cameras
from ._calibration import Calibration
from ._size import Size, agreed_size
from ._source import Source
from ._values import DISTORTION

KIND = "tspslam calibration file"
_KEYS = ("fx", "fy", "cx", "cy", "baseline", "left", "right", "T_right_left")


def is_own(source: Source) -> bool:
    """Tell whether a mapping has keys of our files."""
    return any(key in source for key in _KEYS)


def read_own(source: Source, size: Size | None = None) -> Calibration:
    """Read the file anew, as our own."""
    cameras = load_cameras(source.path)
    camera = cameras if isinstance(cameras, Rig) else cameras.left
    agreed_size(source, {"width": (camera.width, "width"), "height": (camera.height, "height")}, size)
    return Calibration(cameras, KIND, _origin(source, cameras))


def _origin(source: Source, cameras: Rig | RawRig) -> dict[str, str]:
    if isinstance(cameras, Rig):
        return {field.name: field.name for field in fields(Rig) if field.name in source}
    origin = {"T_right_left": "T_right_left"}
    for side in ("left", "right"):
        part = source.part(side)
        for field in (each.name for each in fields(Camera) if each.name != "distortion"):
            if field in part or field in source:
                origin[f"{side}.{field}"] = part.label(field) if field in part else field
        for k, name in enumerate(DISTORTION[: len(part.values.get("distortion", ()))]):
            origin[f"{side}.{name}"] = f"{part.label('distortion')}[{k}]"
    return origin
