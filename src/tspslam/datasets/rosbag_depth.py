"""Colour images and depths in bags of ROS 1 and ROS 2."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from .._checks import require
from .._files import PathLike, bad_input
from ..errors import InputError
from ..types import Camera, Image
from ..vision.calibration.formats import read_calibration
from ..vision.depth.sensor import SENSORS, DepthSensor
from ._bags import BAG, Bag, guarded
from ._depth_image import depth_of
from ._depth_reader import DepthCameras, DepthReader, depth_cameras
from ._depth_recording import DepthRecording
from ._encodings import COMPRESSED, image_of
from ._pairing import NANOSECONDS, check_stamps, pair_by_stamp, path_of, seconds, some
from ._rgbd_topics import ALIGNED, camera_of, rgbd_topics
from ._ros import CAMERA_INFO, IMAGE, Info, info_topic

_APART = 0.6  # of the interval between images, as for folders


class RgbdBag(DepthRecording):
    """Colour images and aligned depths of a bag of ROS 1 or ROS 2, as RealSense and Azure record them.

    Needs the library rosbags (``pip install tspslam[ros]``). Depths are ``sensor_msgs/Image`` of 16UC1 (mm) or 32FC1
    (m), or ``compressedDepth`` (PNG). They must be of the colour camera's pixels: the camera info beside them says so,
    or the calibration that is given has both cameras.

    Parameters
    ----------
    path : str or path
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
        self, path: PathLike, *, colour: str | None = None, depth: str | None = None, calib: PathLike | None = None,
        sensor: DepthSensor | None = None, bits: int | None = None,
    ) -> None:  # fmt: skip
        self.path = path_of(path)
        self._bag = Bag(self.path, (IMAGE, COMPRESSED, CAMERA_INFO))
        self._kinds = self._bag.kinds
        self.topics = rgbd_topics(self.path, self._kinds, colour, depth)
        self._pair()
        sensor = sensor or SENSORS["stereo"]
        require(sensor, DepthSensor, "rgbd: sensor")
        cameras = self._own_cameras() if calib is None else self._given_cameras(calib)
        names = [str(one) for one, _ in self._pairs]
        self._reader = DepthReader(cameras, sensor, None, self._colour, self._depth, names, bits)
        self._reader.check(f"{self.path}: {self.topics[1]}")
        self.rig = self._reader.rig

    def _pair(self) -> None:
        """Find the pairs by the stamps of the headers."""
        self._times: dict[str, dict[int, int]] = {topic: {} for topic in self.topics}
        with self._bag.messages(self.topics) as messages:
            for topic, time, data in messages:
                self._times[topic].setdefault(self._stamp(topic, data), time)
        for topic, times in self._times.items():
            if set(times) == {0}:
                raise bad_input(self.path, f"all stamps on {topic} are 0", "times in the headers of the images")
            check_stamps(Path(f"{self.path}: {topic}"), seconds(list(times)), "nanoseconds")
        one, other = ({stamp: Path(str(stamp)) for stamp in self._times[topic]} for topic in self.topics)
        matched = pair_by_stamp(dict(one), dict(other), self.topics, apart=_APART)
        paired = some(matched, self.path, "images with depths of one clock")
        self._pairs = [(int(one.name), int(other.name)) for one, other in paired.files]
        self.stamps, self.unpaired = paired.stamps, paired.unpaired
        self.apart = seconds([other - one for one, other in self._pairs])

    def _stamp(self, topic: str, data: Any) -> int:
        stamp = self._bag.deserialize(data, self._kinds[topic]).header.stamp
        return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)

    def _message(self, side: int, index: int) -> Any:
        topic, stamp = self.topics[side], self._pairs[index][side]
        time = self._times[topic][stamp]
        with self._bag.messages([topic], time, time + 1) as messages:
            for _, _, data in messages:
                if self._stamp(topic, data) == stamp:
                    return self._bag.deserialize(bytes(data), self._kinds[topic])
        raise bad_input(self.path, f"the image on {topic} at {stamp} ns is gone", "a bag that nothing changes")

    def _colour(self, index: int) -> Image:
        message = self._message(0, index)
        with guarded(self.path):
            try:
                return image_of(message, self._kinds[self.topics[0]])
            except InputError as error:
                raise self._wrong(0, index, error) from error

    def _depth(self, index: int) -> NDArray[Any]:
        message = self._message(1, index)
        with guarded(self.path):
            try:
                return depth_of(message, is_compressed=self._kinds[self.topics[1]] == COMPRESSED)
            except InputError as error:
                raise self._wrong(1, index, error) from error

    def _wrong(self, side: int, index: int, error: InputError) -> InputError:
        where = f"the image on {self.topics[side]} at {self._pairs[index][side]} ns"
        return bad_input(self.path, f"{where} {error}", "a whole sensor_msgs/Image or CompressedImage")

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
        with self._bag.messages([place]) as messages:
            for _, _, data in messages:
                return camera_of(self.path, Info(place, self._bag.deserialize(data, CAMERA_INFO)))
        raise bad_input(self.path, f"has no message on {place}, though it counts some", BAG)

    @property
    def _known(self) -> dict[str, str]:
        return self._kinds | {self._plain(topic): IMAGE for topic in self.topics}

    def _plain(self, topic: str) -> str:
        """Topic that a compressed one is of."""
        return topic.rpartition("/")[0] if self._kinds.get(topic) == COMPRESSED else topic

    def _given_cameras(self, calib: PathLike) -> DepthCameras:
        shape = self._colour(0).shape
        return depth_cameras(read_calibration(calib, (shape[1], shape[0])).cameras, Path(calib).name)
