"""Colour images and depths in bags of ROS 1 and ROS 2."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from .._checks import require
from .._files import PathLike, bad_input
from ..types import Camera, Image
from ..vision.calibration.formats import read_calibration
from ..vision.depth.sensor import SENSORS, DepthSensor
from ._bag_images import BagPairs
from ._depth_image import depth_of
from ._depth_reader import DepthCameras, DepthReader, depth_cameras
from ._depth_recording import DepthRecording
from ._encodings import COMPRESSED, image_of
from ._rgbd_topics import ALIGNED, rgbd_topics
from ._ros import IMAGE, camera_of, info_topic

_APART = 0.6  # of the interval between images, as for folders


class RgbdBag(DepthRecording):
    """Colour images and aligned depths of a bag of ROS 1 or ROS 2, as RealSense and Azure record them.

    Needs the library rosbags (``pip install tspslam[ros]``). Depths are ``sensor_msgs/Image`` of 16UC1 (mm) or 32FC1
    (m), or ``compressedDepth`` (PNG). They must be of the colour camera's pixels: the camera info beside them says so,
    or the calibration that is given has both cameras.

    Parameters
    ----------
    path : str, path or sequence of them
        As `RosbagSequence` takes it.
    colour, depth : str, optional
        Topics. By default the one with "color" or "rgb" in its name, and the one with "depth", aligned ones and raw
        pixels first.
    calib : str or path, optional
        Calibration in the place of the camera infos, as `RgbdSequence` takes it.
    sensor : DepthSensor, optional
        How depths scatter; that of stereo (RealSense) by default.
    bits : int, optional
        As `StereoFolder`.

    Attributes
    ----------
    rig : Rig
        The virtual rig, as of `RgbdSequence`.
    stamps, apart, unpaired
        As `RgbdSequence`.
    topics : tuple of 2 str
        Of colour and depth.

    Raises
    ------
    InputError
        As `RosbagSequence` and `RgbdSequence`.

    Examples
    --------
    >>> RgbdBag("no-such.bag")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such.bag: cannot be opened (No such file or directory); expected a whole bag of ...
    """

    kind = "bag"

    def __init__(
        self, path: PathLike | Sequence[PathLike], *, colour: str | None = None, depth: str | None = None,
        calib: PathLike | None = None, sensor: DepthSensor | None = None, bits: int | None = None,
    ) -> None:  # fmt: skip
        self._stored = BagPairs(path, lambda bag: rgbd_topics(bag.path, bag.kinds, colour, depth), _APART)
        self.path, self.topics, self._kinds = self._stored.path, self._stored.topics, self._stored.bag.kinds
        self.stamps, self.unpaired, self.apart = self._stored.stamps, self._stored.unpaired, self._stored.apart
        sensor = sensor or SENSORS["stereo"]
        require(sensor, DepthSensor, "rgbd: sensor")
        cameras = self._own_cameras() if calib is None else self._given_cameras(calib)
        self._reader = DepthReader(cameras, sensor, None, self._colour, self._depth, self._stored.names, bits)
        self._reader.check(f"{self.path}: {self.topics[1]}")
        self.rig = self._reader.rig

    def _colour(self, index: int) -> Image:
        return self._stored.read(0, index, image_of)

    def _depth(self, index: int) -> NDArray[Any]:
        return self._stored.read(1, index, lambda message, kind: depth_of(message, is_compressed=kind == COMPRESSED))

    def _own_cameras(self) -> DepthCameras:
        """The colour camera of its camera info, if the depths are of the same pixels."""
        own = self._camera(self.topics[0])
        named = any(word in self.topics[1] for word in ALIGNED)
        if not named and self._camera(self.topics[1]) != own:
            said = f"depths on {self.topics[1]} are of another camera than images on {self.topics[0]}"
            wanted = (
                "aligned ones (RealSense: align_depth), or a calibration of both (--calib, colour left, depth right)"
            )
            raise bad_input(self.path, said, wanted)
        return DepthCameras(own, origin=info_topic(self.path, self._plain(self.topics[0]), self._known))

    def _camera(self, topic: str) -> Camera:
        """The camera that took the images of a topic."""
        place = info_topic(self.path, self._plain(topic), self._known)
        return camera_of(self.path, self._stored.info(place))

    @property
    def _known(self) -> dict[str, str]:
        return self._kinds | {self._plain(topic): IMAGE for topic in self.topics}

    def _plain(self, topic: str) -> str:
        """Topic that a compressed one is of."""
        return topic.rpartition("/")[0] if self._kinds.get(topic) == COMPRESSED else topic

    def _given_cameras(self, calib: PathLike) -> DepthCameras:
        shape = self._colour(0).shape
        return depth_cameras(read_calibration(calib, (shape[1], shape[0])).cameras, Path(calib).name)
