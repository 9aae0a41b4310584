"""Stereo images in bags of ROS 1 and ROS 2."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from .._files import PathLike, bad_input
from ..errors import InputError
from ..types import FloatArray, RawRig, Rig, StereoPair
from ..vision.calibration.formats import read_calibration
from ._bag_images import BagImages
from ._pairing import checked_index, path_of
from ._reader import Reader
from ._ros import cameras, info_topic, is_rectified, named


class RosbagSequence:
    """Stereo images of a bag of ROS 1 or ROS 2, with their stamps; raw pairs are rectified.

    Needs the library rosbags (``pip install tspslam[ros]``), not ROS. Topics are of ``sensor_msgs/Image`` (grey, colour
    or a Bayer mosaic of 8 or 16 bits, YUV 4:2:2, NV12 and NV21) or ``CompressedImage`` (JPEG, PNG; of a mosaic too),
    each with a ``CameraInfo`` beside it, or with a calibration that is given. YUV is taken as BT.601 with luma from 16
    to 235, ``8UC3`` as B, G, R. Images are taken as rectified if the topic's name says ``rect``, or if the
    camera info leaves nothing to rectify; a calibration that is given says by its kind whether they are. Left and right
    images are paired by the stamps of their headers: the same one, else the nearest to each other within a quarter of
    the median interval of the side that has the shorter. The images' topics are read through once when the bag is
    opened, then an image at a time. There is no truth: messages of poses do not say where the camera is in the frame
    they are of.

    Parameters
    ----------
    path : str, path or sequence of them
        A ``.bag`` file of ROS 1; a folder with ``metadata.yaml``, a ``.mcap`` or a ``.db3`` file of ROS 2. A recording
        that was split (``x_0.bag x_1.bag ...``): the folder with all its pieces, or these pieces.
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
        path: PathLike | Sequence[PathLike],
        *,
        left: str | None = None,
        right: str | None = None,
        calib: PathLike | None = None,
        bits: int | None = None,
    ) -> None:
        self._stored = BagImages(path, (left, right))
        self.path, self.topics = self._stored.path, self._stored.topics
        if calib is None:
            where, found = self.path, self._own_cameras(all(map(is_rectified, self.topics)))
        else:
            where = path_of(calib)
            found = self._given_cameras(where)
        self.stamps, self.unpaired = self._stored.stamps, self._stored.unpaired
        try:
            self._reader = Reader(found, self._stored.images, self._stored.names, bits)
        except InputError as error:
            raise named(where, error) from error
        self.rig = self._reader.rig

    @property
    def name(self) -> str:
        """Name of the folder, or of the file without its suffix."""
        return self._stored.name

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, {len(self)} pairs)"

    def __len__(self) -> int:
        return len(self._stored)

    def __getitem__(self, index: int) -> StereoPair:
        """Read pair `index`; IndexError past the end, InputError if a message is bad."""
        index = checked_index(index, len(self))
        try:
            pair = self._reader.read(index)
        except InputError as error:
            raise named(self.path, error) from error
        return replace(pair, stamp=float(self.stamps[index]))

    def __iter__(self) -> Iterator[StereoPair]:
        """Read one pair after another."""
        return (self[index] for index in range(len(self)))

    def _own_cameras(self, rectified: bool) -> Rig | RawRig:
        """Cameras that the bag's camera infos describe."""
        topics = (info_topic(self.path, topic, self._stored.kinds) for topic in self.topics)
        one, other = (self._stored.info(topic) for topic in topics)
        return cameras(self.path, one, other, rectified)

    def _given_cameras(self, calib: Path) -> Rig | RawRig:
        """Cameras of a calibration file; a raw one of images that are rectified already is refused."""
        found = read_calibration(calib, self._stored.size()).cameras
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
