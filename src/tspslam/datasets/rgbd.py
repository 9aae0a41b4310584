"""Recordings of RGB-D cameras: colour images and depth maps in folders."""

from __future__ import annotations

from functools import cached_property

from .._checks import require
from .._files import PathLike
from ..io.images import read_image
from ..types import FloatArray, Trajectory
from ..vision.depth.sensor import SENSORS, DepthSensor
from ._depth_reader import DepthReader
from ._depth_recording import DepthRecording
from ._pairing import path_of, size_of_first
from ._rgbd_layouts import find_files
from .maps import read_map


def read_truth(path: PathLike) -> Trajectory | None:
    """Read the true path of a folder of colour images and depths, which takes no calibration.

    Parameters
    ----------
    path : str or path
        As `RgbdSequence` takes it.

    Returns
    -------
    Trajectory or None
        Of the colour camera at the stamps of its images, NaN where it is not known; None if the folder has none.

    Raises
    ------
    InputError
        As `RgbdSequence`.

    Examples
    --------
    >>> read_truth("no-such-folder")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-folder: is no folder of colour images and depths; expected rgb.txt and ...
    """
    files = find_files(path_of(path), None)
    truth = files.truth()
    return None if truth is None else Trajectory(files.stamps, truth)


class RgbdSequence(DepthRecording):
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

    @cached_property
    def truth(self) -> FloatArray | None:
        """True poses ``T_world_camera`` of the colour camera, (n, 4, 4) float64; None if there are none.

        TUM's are interpolated between two at most 0.1 s away, rows without them are NaN, and so are ScanNet's that are
        infinite. ICL-NUIM's have y up, in the world and in the camera: both are turned, so that y is down.
        """
        return self._files.truth()
