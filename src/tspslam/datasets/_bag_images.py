"""Stereo images of a bag as they are stored: which topics, which pairs, an image at a time."""

from __future__ import annotations

import contextlib
import os
import struct
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from .._files import PathLike, bad_input, one_line
from ..errors import InputError
from ..types import FloatArray, Image
from ._bags import BAG, Bag, guarded
from ._encodings import COMPRESSED, image_of
from ._pairing import NANOSECONDS, Paired, check_stamps, name_of, pair_by_stamp, path_of, seconds, some
from ._ros import CAMERA_INFO, IMAGE, Info, sides

_IMAGE = "a whole sensor_msgs/Image or CompressedImage"
T = TypeVar("T")
Times = dict[int, int]
"""When each message was recorded (ns), by the stamp of its header (ns)."""


class BagPairs:
    """Messages of two topics of a bag, paired by the stamps of their headers.

    They are paired by the same stamp, else by the nearest within a part of the median interval of the side that has the
    shorter. Both topics are read through once, when pairs are asked for the first time, then a message at a time.

    Parameters
    ----------
    path : str, path or sequence of them
        As `RosbagSequence` takes it.
    choose : callable
        Takes the bag and gives the names of both topics.
    apart : float
        That part, from 0 to 1.

    Attributes
    ----------
    path : Path
        The bag, or the first of its pieces.
    bag : Bag
        Its topics and messages.
    topics : tuple of 2 str
        As chosen.
    """

    def __init__(
        self, path: PathLike | Sequence[PathLike], choose: Callable[[Bag], tuple[str, str]], apart: float = 0.25
    ) -> None:
        paths = list(map(path_of, path if isinstance(path, list | tuple) else [path]))
        if not paths:
            raise InputError(f"no file of a bag is given, expected {BAG}")
        self.path, self._apart = paths[0], apart
        self.bag = Bag(paths, (IMAGE, COMPRESSED, CAMERA_INFO))
        self.topics = choose(self.bag)

    @property
    def name(self) -> str:
        """Name of the folder, or of the file without its suffix."""
        return name_of(self.path.resolve().with_suffix("")) if os.path.isfile(self.path) else name_of(self.path)

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
        matched = pair_by_stamp(files[0], files[1], self.topics, apart=self._apart)
        found = some(matched, self.path, "images with stamps in common")
        return Paired(found.files, found.stamps, found.unpaired + again)

    @property
    def stamps(self) -> FloatArray:
        """Times of the left images, s, (n,) float64."""
        return self._paired.stamps

    @property
    def unpaired(self) -> list[str]:
        """Images without a partner, or with the stamp of one before, as ``topic/nanoseconds``."""
        return self._paired.unpaired

    @property
    def apart(self) -> FloatArray:
        """Stamps of the right messages less those of the left, s, (n,) float64."""
        return seconds([int(other.name) - int(one.name) for one, other in self._paired.files])

    @cached_property
    def names(self) -> list[str]:
        """Stamps of the left images, ns, as text."""
        return [first.name for first, _ in self._paired.files]

    def __len__(self) -> int:
        return len(self._paired.files)

    def info(self, topic: str) -> Info:
        """Read the first message of a topic with camera infos."""
        with self.bag.messages([topic]) as messages:
            for _, _, data in messages:
                return Info(topic, self.bag.deserialize(data, CAMERA_INFO))
        raise bad_input(self.path, f"has no message on {topic}, though it counts some", BAG)

    def read(self, side: int, index: int, decode: Callable[[Any, str], T]) -> T:
        """Read one side of a pair.

        Parameters
        ----------
        side : int
            0 or 1.
        index : int
            Of the pair.
        decode : callable
            What makes something of a message and the type of its topic; its InputError says what is wrong, not where.

        Returns
        -------
        object
            As `decode` gives it.
        """
        topic, stamp = self.topics[side], int(self._paired.files[index][side].name)
        kind = self.bag.kinds[topic]
        message = self.bag.deserialize(self._message(topic, stamp, self._times[side][stamp]), kind)
        with guarded(self.path):
            try:
                return decode(message, kind)
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


class BagImages(BagPairs):
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
        super().__init__(path, lambda bag: sides(bag.path, _plain(bag.kinds), *(topics or (None, None)), bag.others))

    @cached_property
    def kinds(self) -> dict[str, str]:
        """Type of the messages of each topic that has some."""
        return _plain(self.bag.kinds)

    def images(self, index: int) -> Iterator[Image]:
        """Read the left and the right image of a pair as they are in the bag; `InputError` if one is bad."""
        return (self.read(side, index, image_of) for side in (0, 1))

    def size(self) -> tuple[int, int] | None:
        """Width and height of the first left image that has them, px."""
        for index in range(len(self)):
            with contextlib.suppress(InputError):
                shape = next(self.images(index)).shape
                return shape[1], shape[0]
        return None


def _plain(kinds: dict[str, str]) -> dict[str, str]:
    """Without depths in PNG, which have a header of their own before the image."""
    return {topic: kind for topic, kind in kinds.items() if not topic.endswith("compressedDepth")}
