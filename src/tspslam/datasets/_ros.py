"""What bags of ROS and their messages say: which topics are a pair, their cameras, the pixels of an image."""

from __future__ import annotations

import contextlib
import io
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .._files import bad_input, one_line, reason_of
from ..errors import InputError
from ..io.images import _DECODER_ERRORS, _check_png, _check_size, _open_header, _quiet, load_pixels
from ..types import Camera, Image, RawRig, Rig
from ..vision.calibration.formats._source import Source
from ..vision.calibration.formats._values import (
    DISTORTION,
    OPENCV_COUNTS,
    Found,
    distortion,
    from_camera_matrix,
    from_projections,
    motion,
    rotation,
)

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
_SIDES = (
    ("left", "right"),
    ("cam0", "cam1"),
    ("camera0", "camera1"),
    ("infra1", "infra2"),
    ("Infrared_1", "Infrared_2"),
    ("image_0", "image_1"),
    ("image_00", "image_01"),
)
_RECTIFIED = re.compile(r"(?<![a-z])rect(?:ified)?(?![a-z])")
_MAX_LISTED, _LONGEST_NAME = 20, 80
_FILES = (".bag", ".mcap", ".db3")
STORED = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")  # in a folder of ROS 2
_BROWN = ("plumb_bob", "rational_polynomial", "")  # the second one is Brown's where k4, k5 and k6 are 0
_TURNED = 1e-6  # of R against no rotation
_SAME = 1e-3  # px, of K against P
_SMALLEST_MOSAIC = 3  # px a side
_PADDED, _PADDING = 2, 4096  # of a row: one image of two side by side, and bytes to the end of a page of memory
_GREY, _RGB, _BGR = (0,), (0, 1, 2), (2, 1, 0)
_ENCODINGS: dict[str, tuple[str, int, tuple[int, ...]]] = {
    "mono8": ("u1", 1, _GREY),
    "8UC1": ("u1", 1, _GREY),
    "mono16": ("u2", 1, _GREY),
    "16UC1": ("u2", 1, _GREY),
    "rgb8": ("u1", 3, _RGB),
    "bgr8": ("u1", 3, _BGR),
    "rgba8": ("u1", 4, _RGB),
    "bgra8": ("u1", 4, _BGR),
}
"""For each encoding: type of a value, values of a pixel, and which of them are grey or R, G, B."""
_MOSAICS = {f"bayer_{order}8": f"COLOR_Bayer{order.upper()}2RGB" for order in ("rggb", "bggr", "gbrg", "grbg")}
"""For each encoding of a Bayer mosaic: OpenCV's name of what makes it RGB."""
_ENCODINGS |= dict.fromkeys(_MOSAICS, ("u1", 1, _GREY))


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag: a file with the suffix of one, or a folder of ROS 2."""
    if not os.path.isdir(path):
        return path.suffix.lower() in _FILES
    with contextlib.suppress(OSError):
        names = os.listdir(path)
        return "metadata.yaml" in names and any(name.endswith(STORED) for name in names)
    return False


@dataclass(frozen=True)
class Info:
    """A CameraInfo message and where it stands."""

    topic: str
    message: Any

    def field(self, name: str) -> list[float]:
        """Return the numbers of D, K, R or P, which ROS 2 writes in small letters."""
        values: list[float] = getattr(self.message, name if hasattr(self.message, name) else name.lower()).tolist()
        return values


def is_rectified(topic: str) -> bool:
    """Whether a topic's name says that its images are rectified."""
    return _RECTIFIED.search(topic) is not None


def sides(
    path: Path, kinds: Mapping[str, str], left: str | None, right: str | None, others: Sequence[str] = ()
) -> tuple[str, str]:
    """Return the topics of the left and the right images: those asked for, else the best pair if there is one.

    `kinds` are the types of the topics with images and camera infos, `others` the topics of other types. Images with
    camera infos go before those without, rectified ones before raw ones, then raw pixels before compressed ones.
    """
    images = {topic: kind for topic, kind in kinds.items() if kind != CAMERA_INFO}
    if not images:
        seen = f"; its topics are {_listed(others)}" if others else ""
        raise bad_input(path, f"has no topic with images{seen}", "sensor_msgs/Image or CompressedImage")
    for given in (left, right):
        if given is not None and given not in list(images):
            raise bad_input(path, f"has no images on {str(given)[:80]}", f"one of {_listed(images)}")
    if left is not None and left == right:
        raise bad_input(path, f"left and right are both {left}", f"two of {_listed(images)}")
    if left is not None and right is not None:
        return left, right
    found = [pair for pair in partners(images) if left in (None, pair[0]) and right in (None, pair[1])]
    lone = [any(_info_of(topic, kinds) is None for topic in pair) for pair in found]
    ranks = [
        (bare, not is_rectified(one), images[one] == COMPRESSED) for bare, (one, _) in zip(lone, found, strict=True)
    ]
    best = [pair for pair, rank in zip(found, ranks, strict=True) if rank == min(ranks)]
    if len(best) != 1:
        said = f"has {len(best) or 'no'} pairs of topics with images that look like left and right"
        raise bad_input(path, said, f"two to be given (--topics LEFT RIGHT), of {_listed(images)}")
    return best[0]


def partners(images: Mapping[str, str]) -> list[tuple[str, str]]:
    """Topics whose names differ in nothing but the side."""
    pairs = [(topic, topic.replace(one, other)) for topic in images for one, other in _SIDES if one in topic]
    return sorted({pair for pair in pairs if pair[1] in images})


def _listed(topics: Iterable[str]) -> str:
    names = sorted(topics)
    more = f" and {len(names) - _MAX_LISTED} more" if len(names) > _MAX_LISTED else ""
    return ", ".join(name[:_LONGEST_NAME] for name in names[:_MAX_LISTED]) + more


def info_topic(path: Path, topic: str, known: Mapping[str, str]) -> str:
    """Return the topic of the CameraInfo beside or below one of images."""
    found = _info_of(topic, known)
    if found is None:
        wanted = f"one on {' or '.join(_places(topic, known[topic]))}, or a calibration (--calib)"
        raise bad_input(path, f"has no CameraInfo of {topic}", wanted)
    return found


def _info_of(topic: str, known: Mapping[str, str]) -> str | None:
    return next((place for place in _places(topic, known[topic]) if known.get(place) == CAMERA_INFO), None)


def _places(topic: str, kind: str) -> list[str]:
    base = topic.rpartition("/")[0] if kind == COMPRESSED else topic
    return [f"{folder}/camera_info" for folder in (base.rpartition("/")[0], base)]


def cameras(path: Path, left: Info, right: Info, rectified: bool) -> Rig | RawRig:
    """Return the cameras of two CameraInfo messages: P of rectified images, else K, D, R and P.

    Raw images whose cameras have no distortion, no rotation and K as in P are rectified ones.
    """
    values = {f"{info.topic}.{name}": info.field(name) for info in (left, right) for name in "DKRP"}
    source = Source(path, values)
    found = from_projections(source, f"{left.topic}.P", f"{right.topic}.P")
    if not rectified:
        for info in (left, right):
            _check_model(source, info)
    try:
        if rectified or not any(_is_raw(source, info) for info in (left, right)):
            return Rig(**_plain(found), width=int(left.message.width), height=int(left.message.height))
        return _raw_rig(source, left, right, found["baseline"][0])
    except InputError as error:
        raise _named(path, error) from error


def _named(path: Path, error: InputError) -> InputError:
    said = one_line(str(error))
    return InputError(said if said.startswith(one_line(str(path))) else one_line(f"{path}: {said}"))


def _plain(found: Found) -> dict[str, Any]:
    return {name: value for name, (value, _) in found.items()}


def _check_model(source: Source, info: Info) -> None:
    model = str(info.message.distortion_model)
    if model not in _BROWN:
        raise source.wrong(f"{info.topic}.distortion_model", model, "plumb_bob, or topics of rectified images")


def _is_raw(source: Source, info: Info) -> bool:
    K, P = source.matrix(f"{info.topic}.K", 3, 3), source.matrix(f"{info.topic}.P", 3, 4)
    turn = np.abs(source.matrix(f"{info.topic}.R", 3, 3) - np.eye(3)).max()
    return bool(any(info.field("D")) or turn > _TURNED or np.abs(K - P[:, :3]).max() > _SAME)


def _raw_rig(source: Source, left: Info, right: Info, baseline: float) -> RawRig:
    """x_rectified = R x in both cameras, which differ by the baseline only."""
    R_left, R_right = (rotation(source, f"{info.topic}.R") for info in (left, right))
    T = motion(R_right.T @ R_left, (R_right.T @ (-baseline, 0, 0)).tolist())
    rows = [(float(a), float(b), float(c), float(d)) for a, b, c, d in T.tolist()]
    return RawRig(_camera(source, left), _camera(source, right), tuple(rows))


def _camera(source: Source, info: Info) -> Camera:
    lens = distortion(source, f"{info.topic}.D", *OPENCV_COUNTS) if info.field("D") else {}
    k1, k2, p1, p2, k3 = (lens[name][0] if name in lens else 0.0 for name in DISTORTION)
    pinhole = _plain(from_camera_matrix(source, f"{info.topic}.K"))
    width, height = int(info.message.width), int(info.message.height)
    return Camera(**pinhole, width=width, height=height, distortion=(k1, k2, p1, p2, k3))


def image_of(message: Any, kind: str) -> Image:
    """Return the pixels of an image message, grey or RGB; the InputError says what is wrong, not where."""
    return _compressed(message) if kind == COMPRESSED else _raw(message)


def _raw(message: Any) -> Image:
    encoding = str(message.encoding)
    if encoding not in _ENCODINGS:
        raise InputError(f"has the encoding {encoding[:40]!r}, not one of {', '.join(_ENCODINGS)}")
    width, height, step = int(message.width), int(message.height), int(message.step)
    _check_size((width, height))
    kind, count, channels = _ENCODINGS[encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    used = width * count * dtype.itemsize
    if not used <= step <= _PADDED * used + _PADDING or message.data.size != step * height:
        said = f"{message.data.size} bytes of data and a step of {step}"
        raise InputError(
            f"has {said}, where {width} x {height} px of {encoding} go with a step of {used} or somewhat more"
        )
    rows = np.ascontiguousarray(message.data.reshape(height, step)[:, :used]).view(dtype)
    if encoding in _MOSAICS:
        return _coloured(rows, _MOSAICS[encoding])
    if count == 1:
        return rows.astype(dtype.newbyteorder("="))
    return np.ascontiguousarray(rows.reshape(height, width, count)[..., channels])


def _coloured(mosaic: Image, conversion: str) -> Image:
    import cv2

    if min(mosaic.shape) < _SMALLEST_MOSAIC:
        said = f"{mosaic.shape[1]} x {mosaic.shape[0]} px"
        raise InputError(f"is a Bayer mosaic of {said}, where at least {_SMALLEST_MOSAIC} a side go")
    made: Image = cv2.cvtColor(mosaic, getattr(cv2, conversion))
    return made


def _compressed(message: Any) -> Image:
    before, _, after = str(message.format).partition("compressed")
    if "bayer" in (after.strip() or before):
        raise InputError(f"has the format {message.format[:40]!r}: a Bayer mosaic, not grey or colour")
    handle = io.BytesIO(message.data.tobytes())
    try:
        _check_png(handle)
        with _quiet():
            image = _open_header(handle)
        if image.format not in ("JPEG", "PNG"):
            raise InputError(f"is a {image.format}, not a JPEG or PNG")
        _check_size(image.size)
        return load_pixels(image, handle)
    except _DECODER_ERRORS as error:
        raise InputError(f"cannot be decoded ({reason_of(error)})") from error
