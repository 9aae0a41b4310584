"""What bags of ROS and their messages say: which topics are a pair, their cameras, the pixels of an image."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .._files import bad_input, one_line
from ..errors import InputError
from ..types import Camera, RawRig, Rig
from ..vision.calibration.formats._camera_info import Keys, from_camera_info, from_camera_infos
from ..vision.calibration.formats._source import Source
from ._encodings import COMPRESSED

IMAGE = "sensor_msgs/msg/Image"
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
_FIELDS = ("width", "height", "distortion_model", "D", "K", "R", "P")  # of a CameraInfo, as `Keys` has them


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

    def values(self) -> dict[str, Any]:
        """Return all fields that tell of a camera, by topic and name."""
        plain: dict[str, Any] = {"width": int(self.message.width), "height": int(self.message.height)}
        plain["distortion_model"] = str(self.message.distortion_model)
        return {f"{self.topic}.{name}": plain[name] if name in plain else self.field(name) for name in _FIELDS}

    @property
    def keys(self) -> Keys:
        """Where these fields are among `values`."""
        return Keys(*(f"{self.topic}.{name}" for name in _FIELDS))


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
        if not found:
            said += f"; its topics are {_listed([*(f'{topic} ({kind})' for topic, kind in kinds.items()), *others])}"
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
    values = {key: value for info in (left, right) for key, value in info.values().items()}
    with _naming(path):
        source = Source(path, values)
        return from_camera_infos(source, left.keys, right.keys, kind="CameraInfo", is_rectified=rectified).cameras


def camera_of(path: Path, info: Info) -> Camera:
    """Return the camera of a CameraInfo message, as images that are not rectified have it."""
    with _naming(path):
        return from_camera_info(Source(path, info.values()), info.keys)


@contextlib.contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Put the file before what is wrong with its values."""
    try:
        yield
    except InputError as error:
        raise named(path, error) from error


def named(path: Path, error: InputError) -> InputError:
    """Return the error with the file that it is of, if it does not begin with that."""
    said = one_line(str(error))
    return type(error)(said if said.startswith(one_line(str(path))) else one_line(f"{path}: {said}"))
