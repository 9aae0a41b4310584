"""Recordings of RGB-D cameras: colour images and depth maps in folders."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np

from .._checks import require
from .._files import PathLike
from ..io.images import read_image
from ..types import FloatArray, Rig, StereoPair
from ..vision.stereo.depth_sensor import SENSORS, DepthSensor
from ._depth_reader import DepthReader, clock_doubts
from ._pairing import checked_index, name_of, path_of, size_of_first
from ._rgbd_layouts import find_files
from .maps import read_map


class RgbdSequence:
    """A recording of an RGB-D camera: each pair has an image, and disparities of a virtual rig with their spread.

    Folders are TUM's (``rgb.txt``, ``depth.txt``, ``groundtruth.txt``), ICL-NUIM's in TUM's form (``associations.txt``,
    ``*.gt.freiburg``), ScanNet's (``color/ depth/ pose/ intrinsic/``), or plain ones with ``rgb/`` (or ``color/``) and
    ``depth/`` whose files have the same names. Depths that belong to no surface (`flying_pixels`) are taken away;
    depths of another camera are registered to the images (`register_depth`), where the calibration has both cameras:
    the colour camera as its left one, the depth camera as its right one. Images of a lens with distortion are
    undistorted.

    Parameters
    ----------
    path : str or path
        The folder.
    calib : str or path, optional
        Calibration, as `tspslam.read_calibration` reads it; its baseline is not looked at where it is of one camera.
        By default ``calib.yaml`` in the folder; else ScanNet's own; else what TUM and ICL-NUIM publish for their
        cameras, where the folder's name has ``freiburg1``, ``2`` or ``3``, or it holds ``*.gt.freiburg``.
    unit : float, optional
        Metres in one step of depths that are whole numbers; by default 1 / 5000 for TUM and ICL-NUIM, 0.001 for
        ScanNet. Plain folders need it. Floats are metres.
    sensor : DepthSensor, optional
        How depths scatter; that of structured light by default.
    bits : int, optional
        How many bits 16-bit images use, as in `StereoFolder`.

    Attributes
    ----------
    rig : Rig
        The virtual rig (`virtual_rig`): the colour camera without distortion, and a baseline.
    kind : str
        TUM, ICL-NUIM, ScanNet or plain.
    calibration : str
        Where the cameras come from.
    stamps : (n,) float64
        Times of the images, s; of images that are only numbered, their number at 30 a second, of plain ones the number.
    apart : (n,) float64
        Times of the depths less those of the images, s.
    unpaired : list of str
        Images without depths and depths without an image.

    Raises
    ------
    InputError
        If a part is missing or cannot be read, images and depths are of different clocks or sizes, there is no unit,
        no depth is known, or the median depth is far from what the sensor measures.

    Examples
    --------
    >>> RgbdSequence("no-such-folder")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-folder: is no folder of colour images and depths; expected rgb.txt and ...
    """

    rig: Rig
    stamps: FloatArray
    unpaired: list[str]

    def __init__(
        self, path: PathLike, calib: PathLike | None = None, *, unit: float | None = None,
        sensor: DepthSensor | None = None, bits: int | None = None,
    ) -> None:  # fmt: skip
        self.path = path_of(path)
        require(sensor or SENSORS["structured_light"], DepthSensor, "rgbd: sensor")
        files = find_files(self.path, calib)
        self._files, self.kind, self.unpaired = files, files.kind, files.unpaired
        self.stamps, self.apart = files.stamps, files.apart
        cameras = files.cameras(size_of_first([(file, file) for file in files.colour]))
        self.calibration = cameras.origin
        self._reader = DepthReader(
            cameras, sensor or SENSORS["structured_light"], files.unit if unit is None else unit,
            lambda k: read_image(files.colour[k]), lambda k: read_map(files.depth[k]),
            [file.stem for file in files.colour], bits,
        )  # fmt: skip
        self._reader.check(self.path / "depth")
        self.rig = self._reader.rig

    @property
    def name(self) -> str:
        """The folder's own name."""
        return name_of(self.path)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, {len(self)} pairs)"

    def __len__(self) -> int:
        return len(self._files.colour)

    def __getitem__(self, index: int) -> StereoPair:
        """Read pair `index`; IndexError past the end, InputError if a file is bad."""
        index = checked_index(index, len(self))
        return self._reader.read(index, float(self.stamps[index]))

    def __iter__(self) -> Iterator[StereoPair]:
        """Read one pair after another."""
        return (self[index] for index in range(len(self)))

    @cached_property
    def truth(self) -> FloatArray | None:
        """True poses ``T_world_camera`` of the colour camera, (n, 4, 4) float64; None if there are none.

        TUM's are interpolated between two at most 0.1 s away, rows without them are NaN, and so are ScanNet's that are
        infinite. ICL-NUIM's have y up, in the world and in the camera: both are turned, so that y is down.
        """
        return self._files.truth()

    def describe(self) -> dict[str, Any]:
        """Tell of the depths what ``run.json`` says: sensor, unit, calibration, shares of a few maps, clocks.

        Returns
        -------
        dict
            Fit for JSON; shares of pixels from 0 to 1, times in s.
        """
        apart = np.abs(self.apart)
        clocks = {"apart_median_s": float(np.median(apart)), "apart_max_s": float(apart.max())}
        return {"layout": self.kind} | self._reader.describe() | clocks

    def doubts(self) -> Iterator[dict[str, str]]:
        """Tell what looks wrong with depths that can still be worked with.

        Yields
        ------
        dict of str
            ``code`` and ``message``.
        """
        yield from self._reader.doubts()
        if len(self) > 1:
            yield from clock_doubts(self.apart, float(np.median(np.diff(self.stamps))))
