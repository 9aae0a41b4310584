"""Stereo videos: one file with both images in each frame, or in alternate frames, or a file a side."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from .._checks import require_path
from .._files import PathLike, bad_input, one_line
from ..errors import InputError
from ..types import FloatArray, Image, RawRig, Rig, StereoPair
from ..vision.calibration.formats import Calibration, read_stereo_calibration
from ._pairing import NANOSECONDS, checked_index, pair_by_stamp
from ._reader import Reader
from ._stereo_layouts import LAYOUTS, check_layout, half_size, halves, likely
from ._video import VideoFile

_GAP = 1.5  # of the median step: a longer one lacks a frame
_SAME_RATE = 1.01  # between two videos: clocks differ by far less
_FROZEN = 2  # frames that are the one before them: a single one may be what a camera doubled
_SLOWEST, _FASTEST = 0.01, 1e5  # frames a second
Paths = PathLike | Sequence[PathLike]
OnIndex = Callable[[int, int], object]


class VideoImages:
    """Left and right images of a video, or of two, as they are in it.

    A file is gone through once when it is opened, as long as it takes to decode it; then a frame at a time is in
    memory. Frames of more than 8 bits are brought to 8. A frame is turned as the file says (a phone's does), and then
    it is divided.

    Parameters
    ----------
    paths : str or path, or two of them
        One video with both images, or a left and a right one.
    layout : str, optional
        Of one video: ``"side-by-side"`` (left and right half), ``"over-under"`` (upper and lower half) or
        ``"alternate"`` (left, right, left, ...).
    fps : float, optional
        Frames a second, in place of the times in the file.
    on_index : callable, optional
        Called, while the files are gone through, with how many frames are done and how many there are, as far as the
        containers say.

    Attributes
    ----------
    size : tuple of 2 int
        Width and height of each image, px.
    stamps : (n,) float64
        Times of the left images, s.
    names : list of str
        Number of the left image's frame in its video.
    unpaired : list of str
        Frames without a partner, as ``file/number``. Frames of two videos are paired by their times: those that are
        nearest to each other and within a quarter of the median interval of the side that has the shorter.
    warnings : list of dict
        What is to be said of the videos, each a ``code`` and a ``message``.

    Raises
    ------
    InputError
        If a file is no video that FFmpeg reads, is cut off where nothing can be decoded, has frames of several sizes,
        the layout is not given or does not fit, times do not increase and no `fps` is given, or no frames pair.

    Examples
    --------
    >>> VideoImages("no-such.mp4", "side-by-side")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such.mp4: cannot be opened (No such file or directory); expected a video that ...
    """

    size: tuple[int, int]
    stamps: FloatArray
    names: list[str]
    unpaired: list[str]
    warnings: list[dict[str, str]]

    def __init__(
        self, paths: Paths, layout: str | None = None, *, fps: float | None = None, on_index: OnIndex | None = None
    ) -> None:
        _check_rate(fps)
        self.layout = layout
        self._files, self.size = _opened(paths, layout)
        _tell(self._files, on_index)
        _check_same_rate(self._files, fps)
        times = [_times(each, fps) for each in self._files]
        self._pairs, self.unpaired = self._paired(times)
        self.stamps = np.array([times[0][left] for left, _ in self._pairs], np.float64)
        self.names = [f"{left:06d}" for left, _ in self._pairs]
        self.warnings = [said for each in self._files for said in _remarks(each)]

    @property
    def name(self) -> str:
        """Name of the first file without its suffix."""
        return one_line(self._files[0].path.stem)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, {len(self)} pairs)"

    def __len__(self) -> int:
        return len(self._pairs)

    def images(self, index: int) -> Iterator[Image]:
        """Decode the left and the right image of a pair.

        Parameters
        ----------
        index : int
            From 0.

        Yields
        ------
        (H, W) or (H, W, 3) uint8
            The left, then the right image; colour is RGB.

        Raises
        ------
        InputError
            If the file is not what it was.
        """
        left, right = self._pairs[checked_index(index, len(self))]
        if self.layout in LAYOUTS[:2]:
            yield from map(np.ascontiguousarray, halves(self._files[0][left], self.layout))
        else:
            yield self._files[0][left]
            yield self._files[-1][right]

    def _paired(self, times: list[FloatArray]) -> tuple[list[tuple[int, int]], list[str]]:
        """Numbers of the frames of each pair, and what is left alone."""
        names = [one_line(each.path.name) for each in self._files]
        if len(times) == 2:
            return _by_time(self._files, times)
        count = len(times[0])
        if self.layout in LAYOUTS[:2]:
            return [(k, k) for k in range(count)], []
        if count < 2:
            raise bad_input(self._files[0].path, "has a single frame", "alternate ones, left and right")
        _check_whole(self._files[0])
        lone = [f"{names[0]}/{count - 1}"] if count % 2 else []
        return [(k, k + 1) for k in range(0, count - 1, 2)], lone


class VideoSequence:
    """Rectified pairs of a stereo video, or of two videos, with their times.

    Parameters
    ----------
    paths, layout, fps, on_index
        As `VideoImages`.
    calib : str, path, Rig or RawRig
        Calibration of one image as it is in the video, after the turn and the division: a file, as
        `tspslam.read_calibration` reads it, or the cameras themselves. Raw pairs are rectified.
    bits : int, optional
        As in `StereoFolder`; frames have 8.

    Attributes
    ----------
    rig : Rig
        The cameras of the rectified pairs.
    stamps, names, unpaired, warnings
        As in `VideoImages`.
    remarks : list of str
        What is to be said of the calibration.

    Raises
    ------
    InputError
        As `VideoImages`, or if the calibration is bad, or of images of another size.

    Examples
    --------
    >>> VideoSequence(("left.mp4", "right.mp4"), calib="no-such-calib.yaml")
    Traceback (most recent call last):
    tspslam.errors.InputError: left.mp4: cannot be opened (No such file or directory); expected a video that FFmpeg ...
    """

    rig: Rig
    stamps: FloatArray
    unpaired: list[str]
    warnings: list[dict[str, str]]
    remarks: list[str]

    def __init__(
        self, paths: Paths, layout: str | None = None, *,
        calib: PathLike | Rig | RawRig, fps: float | None = None, bits: int | None = None,
        on_index: OnIndex | None = None,
    ) -> None:  # fmt: skip
        found = calibration_of(calib, image_size(paths, layout))  # before the file is gone through
        self.remarks = list(found.remarks)
        self.images = VideoImages(paths, layout, fps=fps, on_index=on_index)
        self.stamps, self.unpaired, self.warnings = self.images.stamps, self.images.unpaired, self.images.warnings
        self._reader = Reader(found.cameras, self.images.images, self.images.names, bits)
        self.rig = self._reader.rig

    @property
    def name(self) -> str:
        """Name of the first file without its suffix."""
        return self.images.name

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, {len(self)} pairs)"

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, index: int) -> StereoPair:
        """Read pair `index`; IndexError past the end, InputError if a file is not what it was."""
        index = checked_index(index, len(self))
        return replace(self._reader.read(index), stamp=float(self.stamps[index]))

    def __iter__(self) -> Iterator[StereoPair]:
        """Read one pair after another."""
        return (self[index] for index in range(len(self)))


def image_size(paths: Paths, layout: str | None) -> tuple[int, int]:
    """Return the size of each image of a pair, from the headers of the videos.

    Parameters
    ----------
    paths : str or path, or two of them
        One video with both images, or a left and a right one.
    layout : str or None
        Of one video, one of `LAYOUTS`.

    Returns
    -------
    tuple of 2 int
        Width and height, px.

    Raises
    ------
    InputError
        If a file is no video that FFmpeg reads, or the layout is not given or does not fit.
    """
    return _opened(paths, layout)[1]


def calibration_of(calib: PathLike | Rig | RawRig, size: tuple[int, int]) -> Calibration:
    """Return the calibration of images of a size, with what is to be said of it.

    Parameters
    ----------
    calib : str, path, Rig or RawRig
        Where they come from.
    size : tuple of 2 int
        Width and height of each image, px.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If there is no calibration, it is bad, or of another size.
    """
    if calib is None:
        raise InputError("calib is None, expected the calibration of the video's cameras: a file (--calib)")
    found = Calibration(calib, "given", {}) if isinstance(calib, Rig | RawRig) else _read_calibration(calib, size)
    known = found.cameras.left if isinstance(found.cameras, RawRig) else found.cameras
    if (known.width, known.height) != size:
        where = "calib" if isinstance(calib, Rig | RawRig) else str(calib)
        said = f"is of images of {known.width} x {known.height} px, those that are given have {size[0]} x {size[1]} px"
        raise bad_input(where, said, "a calibration of that size, or another layout (--layout)")
    return found


def _read_calibration(calib: PathLike, size: tuple[int, int]) -> Calibration:
    """That of a file: one of another size too, since the error about that names the layout."""
    try:
        return read_stereo_calibration(calib, size)
    except InputError:
        with contextlib.suppress(InputError):
            return read_stereo_calibration(calib)
        raise


def _places(paths: Paths, layout: str | None) -> list[Path]:
    """One file or two; a layout goes with one."""
    given: Sequence[PathLike] = list(paths) if isinstance(paths, list | tuple) else [paths]  # type: ignore[list-item]
    for path in given:
        require_path(path)
    if len(given) not in (1, 2):
        raise InputError(f"paths has {len(given)} videos, expected one, or a left and a right one")
    check_layout(layout)
    if len(given) == 2 and layout is not None:
        raise InputError(f"layout is {layout!r} beside two videos, expected none: each holds one side")
    return [Path(path) for path in given]


def _opened(paths: Paths, layout: str | None) -> tuple[list[VideoFile], tuple[int, int]]:
    """The files, and the size of each image of a pair."""
    files = [VideoFile(place) for place in _places(paths, layout)]
    first, last = files[0], files[-1]
    if len(files) == 1 and layout is None:
        raise _untold(first)
    if first.size != last.size:
        said = "has {} x {} px, {} {} x {} px".format(*last.size, first.path.name, *first.size)
        raise bad_input(last.path, said, "videos of one size")
    return files, half_size(first.size, layout, first.path)


def _tell(files: Sequence[VideoFile], on_index: OnIndex | None) -> None:
    """Have files tell how many frames they have gone through, together."""
    if on_index is None:
        return
    done, total = [0] * len(files), sum(file.declared for file in files)

    def count(k: int, number: int) -> None:
        done[k] = number
        on_index(sum(done), max(total, sum(done)))

    for k, file in enumerate(files):
        file.on_index = partial(count, k)


def _untold(file: VideoFile) -> InputError:
    width, height = file.size
    said = f"is a video of {width} x {height} px whose layout is not told{likely(file.size)}"
    return bad_input(file.path, said, f"layout (--layout) {' or '.join(LAYOUTS)}, or two videos, left and right")


def _check_rate(fps: float | None) -> None:
    if fps is None:
        return
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not _SLOWEST <= fps <= _FASTEST:
        raise InputError(f"fps is {repr(fps)[:40]}, expected frames a second, {_SLOWEST:g} to {_FASTEST:g}")


def _times(file: VideoFile, fps: float | None) -> FloatArray:
    """When each frame was taken, s."""
    if fps is not None:
        return np.arange(len(file)) / fps
    fault = file.fault()
    if fault:
        rate = f" (it says {file.rate:g})" if file.rate > 0 else ""
        raise bad_input(file.path, fault, f"times that increase, or frames a second by --fps (fps=){rate}")
    return file.times


def _check_whole(file: VideoFile) -> None:
    """Refuse alternate frames of which one is lost: left and right would change places from there on."""
    wanted = "all frames of left and right in turn, or a video of each side"
    if file.declared > len(file):
        raise bad_input(file.path, f"has {len(file)} of {file.declared} frames that can be decoded", wanted)
    steps = np.diff(file.times) if file.fault() is None else np.zeros(0)
    late = np.flatnonzero(steps > _GAP * np.median(steps)) if len(steps) else steps
    if len(late):
        k = int(late[0])
        said = f"frames {k} and {k + 1} are {steps[k]:.3g} s apart, others {np.median(steps):.3g} s: one is lost"
        raise bad_input(file.path, said, wanted)


def _check_same_rate(files: Sequence[VideoFile], fps: float | None) -> None:
    """Refuse a rate for two videos whose own times say that they have two."""
    if fps is None or len(files) < 2 or any(file.fault() or len(file) < 2 for file in files):
        return
    rates = [1 / float(np.median(np.diff(file.times))) for file in files]
    if max(rates) > _SAME_RATE * min(rates):
        said = f"has {rates[1]:.4g} frames a second, {files[0].path.name} {rates[0]:.4g}"
        raise bad_input(files[1].path, said, "no one rate beside their times (--fps, fps=)")


def _by_time(files: Sequence[VideoFile], times: Sequence[FloatArray]) -> tuple[list[tuple[int, int]], list[str]]:
    """Pair the frames of two videos that are nearest to each other."""
    labels = one_line(files[0].path.name), one_line(files[1].path.name)
    sides: list[dict[int, Path | None]] = [
        {round(time * NANOSECONDS): Path(str(number)) for number, time in enumerate(each.tolist())} for each in times
    ]
    paired = pair_by_stamp(sides[0], sides[1], labels)
    if not paired.files:
        raise bad_input(files[1].path, f"has no frame at a time of one in {labels[0]}", "videos of the same moments")
    return [(int(left.name), int(right.name)) for left, right in paired.files], paired.unpaired


def _remarks(file: VideoFile) -> Iterator[dict[str, str]]:
    name = one_line(file.path.name)
    if file.turn:
        message = f"{name}: its frames are turned by {file.turn} degrees, as it says; the calibration must be of that"
        yield {"code": "video_turned", "message": message}
    if file.repeated >= _FROZEN:
        message = f"{name}: {file.repeated} of {len(file)} frames are the one before them again, as damaged ones are"
        yield {"code": "video_frozen", "message": message}
    if file.is_cut:
        message = f"{name}: {len(file)} of {file.declared} frames can be decoded; the others are missing"
        yield {"code": "video_cut", "message": message}
