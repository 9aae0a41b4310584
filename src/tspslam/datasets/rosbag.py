"""Stereo images in bags of ROS 1 and ROS 2."""

from __future__ import annotations

import contextlib
import os
import struct
from collections.abc import Iterator
from pathlib import Path

from .._files import PathLike, bad_input, one_line
from ..errors import InputError
from ..types import FloatArray, Image, RawRig, Rig, StereoPair
from ..vision.calibration.formats import read_calibration
from ..vision.calibration.rectify import Rectification, rectification
from ..vision.rig import check_pair
from ._bags import BAG, Bag, guarded
from ._levels import Levels
from ._pairing import NANOSECONDS, check_stamps, checked_index, name_of, pair_by_stamp, path_of, seconds, some
from ._ros import CAMERA_INFO, COMPRESSED, IMAGE, Info, cameras, image_of, info_topic, is_rectified, sides

_IMAGE = "a whole sensor_msgs/Image or CompressedImage"
Times = dict[int, int]
"""When each message was recorded (ns), by the stamp of its header (ns)."""


class RosbagSequence:
    """Stereo images of a bag of ROS 1 or ROS 2, with their stamps; raw pairs are rectified.

    Needs the library rosbags (``pip install tspslam[ros]``), not ROS. Topics are of ``sensor_msgs/Image`` (grey,
    RGB or a Bayer mosaic of 8 bits, grey of 16) or ``CompressedImage`` (JPEG, PNG), each with a ``CameraInfo`` beside
    it, or with a calibration that is given. Images are taken as rectified if the topic's name says ``rect``, or if the
    camera info leaves nothing to rectify; a calibration that is given says by its kind whether they are. Left and right
    images are paired by the stamps of their headers: the same one, else the nearest to each other within a quarter of
    the median interval of the side that has the shorter. The images' topics are read through once when the bag is
    opened, then an image at a time. There is no truth: messages of poses do not say where the camera is in the frame
    they are of.

    Parameters
    ----------
    path : str or path
        A ``.bag`` file of ROS 1; a folder with ``metadata.yaml``, a ``.mcap`` or a ``.db3`` file of ROS 2.
    left, right : str, optional
        Topics of the images. By default the two whose names differ only in left and right, cam0 and cam1, camera0
        and camera1, infra1 and infra2, image_0 and image_1 or image_00 and image_01; those with a ``CameraInfo`` go
        before those without, then rectified images before raw ones, then uncompressed before compressed ones.
    bits : int, optional
        How many bits 16-bit pixels use, as in `StereoFolder`.

    Attributes
    ----------
    rig : Rig
        The cameras of the rectified pairs.
    stamps : (n,) float64
        Times of the left images, s.
    topics : tuple of 2 str
        Topics of the left and the right images.
    unpaired : list of str
        Images without a partner, or with the stamp of one before, as ``topic/nanoseconds``.

    Raises
    ------
    InputError
        If the library or a part is missing, the bag is damaged or has chunks of over 256 MiB, the topics cannot be
        told, the cameras are not of a rectified pair or of lenses that camera infos name, `calib` is
        of raw cameras and the images are known to be rectified, stamps are all 0 or go back in the order of
        recording, or no pair is found.

    Examples
    --------
    >>> RosbagSequence("no-such.bag")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such.bag: cannot be opened (No such file or directory); expected a whole bag of ...
    """

    rig: Rig
    stamps: FloatArray
    topics: tuple[str, str]
    unpaired: list[str]

    def __init__(
        self,
        path: PathLike,
        *,
        left: str | None = None,
        right: str | None = None,
        calib: PathLike | None = None,
        bits: int | None = None,
    ) -> None:
        self.path = path_of(path)
        self._bag = _Images(self.path)
        self.topics = sides(self.path, self._bag.kinds, left, right, self._bag.bag.others)
        if calib is None:
            self._rectify, self.rig = _made(self.path, self._own_cameras(all(map(is_rectified, self.topics))))
        self._pair()
        self._levels = Levels(self._images, len(self._pairs), bits)
        if calib is not None:
            self._rectify, self.rig = _made(path_of(calib), self._given_cameras(path_of(calib)))

    def _pair(self) -> None:
        """Find the pairs by the stamps of the images."""
        self._times, again = self._bag.indexed(self.topics)
        files: list[dict[int, Path | None]] = [{stamp: Path(str(stamp)) for stamp in times} for times in self._times]
        paired = some(pair_by_stamp(files[0], files[1], self.topics), self.path, "images with stamps in common")
        self._pairs = [(int(first.name), int(second.name)) for first, second in paired.files]
        self.stamps, self.unpaired = paired.stamps, paired.unpaired + again

    @property
    def name(self) -> str:
        """Name of the folder, or of the file without its suffix."""
        return name_of(self.path.resolve().with_suffix("")) if os.path.isfile(self.path) else name_of(self.path)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, {len(self)} pairs)"

    def __len__(self) -> int:
        return len(self._pairs)

    def __getitem__(self, index: int) -> StereoPair:
        """Read pair `index`; IndexError past the end, InputError if a message is bad."""
        index = checked_index(index, len(self))
        stored = list(self._images(index))
        try:
            left, right = self._levels(stored)
            if self._rectify:
                left, right = self._rectify(left, right)
            name, bits = str(self._pairs[index][0]), self._levels.bits_of(left)
            pair = StereoPair(left, right, self.rig, float(self.stamps[index]), index, name, bits=bits)
            check_pair(pair)
        except InputError as error:
            raise InputError(one_line(f"{self.path}: {error}")) from error
        return pair

    def __iter__(self) -> Iterator[StereoPair]:
        """Read one pair after another."""
        return (self[index] for index in range(len(self)))

    def _own_cameras(self, rectified: bool) -> Rig | RawRig:
        """Cameras that the bag's camera infos describe."""
        one, other = (self._bag.info(info_topic(self.path, topic, self._bag.kinds)) for topic in self.topics)
        return cameras(self.path, one, other, rectified)

    def _images(self, index: int) -> Iterator[Image]:
        """Both images of a pair as they are in the bag."""
        read = zip(self.topics, self._pairs[index], self._times, strict=True)
        return (self._bag.image(topic, stamp, times[stamp]) for topic, stamp, times in read)

    def _given_cameras(self, calib: Path) -> Rig | RawRig:
        """Cameras of a calibration file; a raw one of images that are rectified already is refused."""
        found = read_calibration(calib, self._size()).cameras
        if isinstance(found, RawRig) and self._says_rectified():
            said = f"is of raw cameras, but images on {self.topics[0]} and {self.topics[1]} are rectified already"
            raise bad_input(calib, said, "a calibration of the rectified pair, or the topics of raw images")
        return found

    def _says_rectified(self) -> bool:
        """Whether the topics' names say that their images are rectified, or camera infos of a pair do."""
        if all(map(is_rectified, self.topics)):
            return True
        with contextlib.suppress(InputError):
            return isinstance(self._own_cameras(rectified=False), Rig)
        return False

    def _size(self) -> tuple[int, int] | None:
        """Size of the first left image that has one."""
        for stamp, _ in self._pairs:
            with contextlib.suppress(InputError):
                shape = self._bag.image(self.topics[0], stamp, self._times[0][stamp]).shape
                return shape[1], shape[0]
        return None


class _Images:
    """A bag's topics with images and camera infos, and their messages one by one."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.bag = Bag(path, (IMAGE, COMPRESSED, CAMERA_INFO))

    @property
    def kinds(self) -> dict[str, str]:
        """Type of the messages of each topic that has some."""
        depth = "compressedDepth"  # has a header of its own before the image
        return {topic: kind for topic, kind in self.bag.kinds.items() if not topic.endswith(depth)}

    def info(self, topic: str) -> Info:
        """First message of a topic with camera infos."""
        with self.bag.messages([topic]) as messages:
            for _, _, data in messages:
                return Info(topic, self.bag.deserialize(data, CAMERA_INFO))
        raise bad_input(self.path, f"has no message on {topic}, though it counts some", BAG)

    def indexed(self, topics: tuple[str, str]) -> tuple[list[Times], list[str]]:
        """When the images of both sides were recorded, and the names of those whose stamp was there before."""
        times: dict[str, Times] = {topic: {} for topic in topics}
        again: list[str] = []
        with self.bag.messages(topics) as messages:
            for topic, time, data in messages:
                stamp = self._stamp(topic, data)
                if stamp in times[topic]:
                    again.append(one_line(f"{topic}/{stamp}"))
                times[topic].setdefault(stamp, time)
        for topic, found in times.items():
            if set(found) == {0}:
                raise bad_input(self.path, f"all stamps on {topic} are 0", "times in the headers of the images")
            check_stamps(Path(f"{self.path}: {topic}"), seconds(list(found)), "nanoseconds")
        return list(times.values()), again

    def image(self, topic: str, stamp: int, time: int) -> Image:
        """Read the image of a stamp that was recorded at a time."""
        kind = self.kinds[topic]
        message = self.bag.deserialize(self._message(topic, stamp, time), kind)
        with guarded(self.path):
            try:
                return image_of(message, kind)
            except InputError as error:
                raise bad_input(self.path, f"the image on {topic} at {stamp} ns {error}", _IMAGE) from error

    def _message(self, topic: str, stamp: int, time: int) -> bytes:
        with self.bag.messages([topic], time, time + 1) as messages:
            for _, _, data in messages:
                if self._stamp(topic, data) == stamp:
                    return bytes(data)
        raise bad_input(self.path, f"the image on {topic} at {stamp} ns is gone", "a bag that nothing changes")

    def _stamp(self, topic: str, data: bytes) -> int:
        """Stamp (ns) of the header that a message begins with."""
        try:
            if self.bag.is2:  # four bytes tell the order of the others
                seconds, rest = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
            else:  # a counter goes before
                seconds, rest = struct.unpack_from("<II", data, 4)
        except (struct.error, IndexError) as error:
            raise bad_input(self.path, f"a message on {topic} has {len(data)} bytes", _IMAGE) from error
        if seconds < 0 or rest >= NANOSECONDS:
            raise bad_input(self.path, f"a message on {topic} has the stamp {seconds} s {rest} ns", "a time after 1970")
        return int(seconds * NANOSECONDS + rest)


def _made(path: Path, given: Rig | RawRig) -> tuple[Rectification | None, Rig]:
    if isinstance(given, Rig):
        return None, given
    try:
        made = rectification(given)
    except InputError as error:
        raise type(error)(one_line(f"{path}: {error}")) from error
    return made, made.rig
