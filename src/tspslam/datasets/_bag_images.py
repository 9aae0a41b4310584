"""Stereo images of a bag as they are stored: which topics, which pairs, an image at a time."""

from __future__ import annotations

import contextlib
import os
import struct
from collections.abc import Iterator, Sequence
from functools import cached_property
from pathlib import Path

from .._files import PathLike, bad_input, one_line
from ..errors import InputError
from ..types import FloatArray, Image
from ._bags import BAG, Bag, guarded
from ._encodings import COMPRESSED, image_of
from ._pairing import NANOSECONDS, Paired, check_stamps, name_of, pair_by_stamp, path_of, seconds, some
from ._ros import CAMERA_INFO, IMAGE, Info, sides

_IMAGE = "a whole sensor_msgs/Image or CompressedImage"
Times = dict[int, int]
"""When each message was recorded (ns), by the stamp of its header (ns)."""


class BagImages:
    """Left and right images of a bag of ROS 1 or ROS 2 as they are stored, without a calibration.

    Left and right images are paired by the stamps of their headers: the same one, else the nearest to each other within
    a quarter of the median interval of the side that has the shorter. The images' topics are read through once, when
    pairs are asked for the first time, then an image at a time.

    Parameters
    ----------
    path : str, path or sequence of them
        As `RosbagSequence` takes it.
    topics : tuple of 2 str or None, optional
        Topics of the left and the right images; None for one that is to be found.

    Attributes
    ----------
    path : Path
        The bag, or the first of its pieces.
    bag : Bag
        Its topics and messages.
    topics : tuple of 2 str
        Topics of the left and the right images.

    Raises
    ------
    InputError
        If the library is missing, the bag is damaged, or the topics cannot be told.

    Examples
    --------
    >>> BagImages("no-such.bag")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such.bag: cannot be opened (No such file or directory); expected a whole bag of ...
    """

    def __init__(
        self, path: PathLike | Sequence[PathLike], topics: tuple[str | None, str | None] | None = None
    ) -> None:
        paths = list(map(path_of, path if isinstance(path, list | tuple) else [path]))
        if not paths:
            raise InputError(f"no file of a bag is given, expected {BAG}")
        self.path = paths[0]
        self.bag = Bag(paths, (IMAGE, COMPRESSED, CAMERA_INFO))
        self.topics = sides(self.path, self.kinds, *(topics or (None, None)), self.bag.others)

    @property
    def name(self) -> str:
        """Name of the folder, or of the file without its suffix."""
        return name_of(self.path.resolve().with_suffix("")) if os.path.isfile(self.path) else name_of(self.path)

    @cached_property
    def kinds(self) -> dict[str, str]:
        """Type of the messages of each topic that has some."""
        depth = "compressedDepth"  # has a header of its own before the image
        return {topic: kind for topic, kind in self.bag.kinds.items() if not topic.endswith(depth)}

    @cached_property
    def _times(self) -> list[Times]:
        return self._indexed[0]

    @cached_property
    def _indexed(self) -> tuple[list[Times], list[str]]:
        """When the images of both sides were recorded, and the names of those whose stamp was there before."""
        times: dict[str, Times] = {topic: {} for topic in self.topics}
        again: list[str] = []
        with self.bag.messages(self.topics) as messages:
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

    @cached_property
    def _paired(self) -> Paired:
        """Pairs by the stamps of the images, which stand for them as names of files."""
        times, again = self._indexed
        files: list[dict[int, Path | None]] = [{stamp: Path(str(stamp)) for stamp in each} for each in times]
        found = some(pair_by_stamp(files[0], files[1], self.topics), self.path, "images with stamps in common")
        return Paired(found.files, found.stamps, found.unpaired + again)

    @property
    def stamps(self) -> FloatArray:
        """Times of the left images, s, (n,) float64."""
        return self._paired.stamps

    @property
    def unpaired(self) -> list[str]:
        """Images without a partner, or with the stamp of one before, as ``topic/nanoseconds``."""
        return self._paired.unpaired

    @cached_property
    def names(self) -> list[str]:
        """Stamps of the left images, ns, as text."""
        return [first.name for first, _ in self._paired.files]

    def __len__(self) -> int:
        return len(self._paired.files)

    def images(self, index: int) -> Iterator[Image]:
        """Read the left and the right image of a pair as they are in the bag; `InputError` if one is bad."""
        read = zip(self.topics, self._paired.files[index], self._times, strict=True)
        return (self._image(topic, int(file.name), times[int(file.name)]) for topic, file, times in read)

    def size(self) -> tuple[int, int] | None:
        """Width and height of the first left image that has them, px."""
        for index in range(len(self)):
            with contextlib.suppress(InputError):
                shape = next(self.images(index)).shape
                return shape[1], shape[0]
        return None

    def info(self, topic: str) -> Info:
        """Read the first message of a topic with camera infos."""
        with self.bag.messages([topic]) as messages:
            for _, _, data in messages:
                return Info(topic, self.bag.deserialize(data, CAMERA_INFO))
        raise bad_input(self.path, f"has no message on {topic}, though it counts some", BAG)

    def _image(self, topic: str, stamp: int, time: int) -> Image:
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
