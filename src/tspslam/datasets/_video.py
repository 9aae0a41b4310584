"""One video file: its frames by number, with the same pixels whichever way one comes to them."""

from __future__ import annotations

import contextlib
import os
import threading
import zlib
from collections.abc import Callable, Iterator
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from .._files import PathLike, bad_input, open_input, reason_of
from ..errors import InputError
from ..io.images import _check_size
from ..types import FloatArray, Image
from ._pairing import NANOSECONDS
from ._video_container import jpeg_size, unreadable

EXPECTED = "a video that FFmpeg reads, such as MP4, MKV or AVI"
_LARGEST = 1 << 50  # bytes
_NEAR = 48  # frames: so many are decoded sooner than a place before them is sought
_BACK = 8, 64, 512  # frames before the one wanted where decoding begins: within its group of pictures, before it, far
_LED = 16  # frames before a place that OpenCV itself begins to decode at
_ROWS = 8  # every eighth row is summed: a block of a codec that is wrong has 8 rows or more
_LOG_NOTHING = 0  # of the levels of OpenCV's log: silent
_SHORT = 2, 0.01  # frames, and share of them, that a file may have fewer than it says: some say it by a mean rate
_GREY = "Y800", "GREY", "Y8  "
_JPEG = "MJPG", "mjpg", "jpeg", "JPEG", "mjpa", "mjpb"
_quiet_lock = threading.Lock()  # of how many threads want silence, and the level before the first did
_silent = _level = 0


class VideoFile:
    """Frames of a video file by their number.

    The file is gone through once, when its times are asked for: a frame's number is its place among those that can be
    decoded. A frame is the one that decoding from the beginning gives: one that is come to by another way is held to
    a checksum of it.

    Parameters
    ----------
    path : str or path
        The file.

    Attributes
    ----------
    size : tuple of 2 int
        Width and height, px, after the turn.
    turn : int
        Degrees, clockwise, that the file says its frames are to be turned by, as a phone's does. It is applied.
    declared : int
        How many frames the container says that it has; 0 where it does not.
    rate : float
        Frames a second, as the container says; 0 where it does not.
    """

    size: tuple[int, int]
    turn: int
    declared: int
    rate: float

    def __init__(self, path: PathLike) -> None:
        open_input(path, EXPECTED, _LARGEST).close()
        self.path = Path(path)
        self._lock = threading.Lock()
        self._capture, self._next = _opened(self.path), 0
        self.on_index: Callable[[int], None] | None = None  # called with how many frames have been gone through
        self._describe()

    @cached_property
    def times(self) -> FloatArray:
        """When each frame is shown, (n,) float64, s, as the container says."""
        return self._indexed[0]

    @cached_property
    def _indexed(self) -> tuple[FloatArray, list[int], dict[float, int]]:
        """When each frame is shown, its checksum, and its number by its time, where times tell frames."""
        if self.codec in _JPEG:
            self._check_sizes()
        times, marks = self._index()
        is_told = bool((np.diff(times) > 0).all())
        return times, marks, dict(zip(times.tolist(), range(len(times)), strict=True)) if is_told else {}

    def __len__(self) -> int:
        return len(self.times)

    def __getitem__(self, number: int) -> Image:
        """Decode a frame, (H, W) or (H, W, 3) uint8 RGB; `InputError` if it is not what it was."""
        marks = self._indexed[1]
        with self._lock, silence(), _errors(self.path):
            for reach in (self._on, *(self._after(back) for back in _BACK), self._anew):
                pixels = reach(number)
                if pixels is not None and _mark(pixels) == marks[number]:
                    return pixels
        raise bad_input(self.path, f"frame {number} is not what it was", "a video that nothing changes meanwhile")

    @property
    def is_cut(self) -> bool:
        """Whether there are fewer frames than the container says."""
        least, share = _SHORT
        return self.declared - len(self) > max(least, share * self.declared)

    @property
    def repeated(self) -> int:
        """How many frames are those before them, by every eighth row."""
        marks = self._indexed[1]
        return sum(one == other for one, other in pairwise(marks))

    def fault(self) -> str | None:
        """Say what is wrong with the times, if anything is."""
        if len(self) > 1 and not self.times.any():
            return "its times are all 0"
        for k, (before, now) in enumerate(pairwise(self.times.tolist()), 1):
            if not now > before:
                return f"frame {k} is at {now:.6f} s, that before it at {before:.6f} s"
        return None

    def _describe(self) -> None:
        import cv2

        said = {name: self._said(getattr(cv2, f"CAP_PROP_{name}")) for name in _SAID}
        with _errors(self.path):
            _check_size((int(said["FRAME_WIDTH"]), int(said["FRAME_HEIGHT"])))
        self.size = int(said["FRAME_WIDTH"]), int(said["FRAME_HEIGHT"])
        self.turn = int(said["ORIENTATION_META"])
        self.declared, self.rate = max(0, int(said["FRAME_COUNT"])), max(0.0, said["FPS"])
        self.codec = _fourcc(said["FOURCC"])
        self._is_grey = _fourcc(said["CODEC_PIXEL_FORMAT"]) in _GREY

    def _said(self, what: int) -> float:
        value = float(self._capture.get(what))
        return value if np.isfinite(value) else 0.0

    def _time(self) -> float:
        """When the frame that was decoded last is shown, s: whole nanoseconds, as other stamps are."""
        import cv2

        return round(self._said(cv2.CAP_PROP_POS_MSEC) * 1e6) / NANOSECONDS

    def _index(self) -> tuple[FloatArray, list[int]]:
        """When each frame is shown, and its checksum."""
        times: list[float] = []
        marks: list[int] = []
        with silence(), _errors(self.path):
            while (pixels := self._grab()) is not None:
                times.append(self._time())
                marks.append(_mark(pixels))
                if self.on_index:
                    self.on_index(len(times))
        if not times:
            raise bad_input(self.path, f"has no frame that can be decoded (its codec is {self.codec})", EXPECTED)
        self._next = len(times)
        return np.array(times, np.float64), marks

    def _check_sizes(self) -> None:
        """Refuse frames of several sizes, as OpenCV gives all the size of the first; it tells no other codec's."""
        found: set[tuple[int, int]] = set()
        with silence(), _errors(self.path):
            packets = _undecoded(self.path)
            while len(found) < 2 and packets.grab():
                size = jpeg_size(packets.retrieve()[1].tobytes())
                found |= {size} if size else set()
        if len(found) > 1:
            said = " and ".join(f"{width} x {height}" for width, height in sorted(found))
            raise bad_input(self.path, f"has frames of {said} px", "frames of one size")

    def _grab(self) -> Image | None:
        """Decode the next frame; None at the end."""
        return self._pixels() if self._capture.grab() else None

    def _pixels(self) -> Image:
        import cv2

        there, bgr = self._capture.retrieve()
        if not there:
            raise bad_input(self.path, "has a frame that cannot be decoded", EXPECTED)
        pixels: Image = np.ascontiguousarray(bgr[..., 0]) if self._is_grey else cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB)
        return pixels

    def _on(self, number: int) -> Image | None:
        """Go on from where the file is, if the frame is near."""
        return self._forward(number) if 0 <= number - self._next <= _NEAR else None

    def _after(self, back: int) -> Any:
        """Way to a frame: decode from so many frames before it, as far as the container finds such a place."""

        def reach(number: int) -> Image | None:
            import cv2

            numbers = self._indexed[2]
            if not (numbers and self.rate) or number <= back + _LED:
                return None
            # OpenCV turns a number into a time by the container's rate.
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, round(float(self.times[number]) * self.rate) - back)
            if not self._capture.grab():
                return None
            found = numbers.get(self._time())
            if found is None or found > number:
                return None
            self._next = found + 1
            return self._pixels() if found == number else self._forward(number)

        return reach

    def _anew(self, number: int) -> Image | None:
        """Decode from the beginning."""
        self._capture, self._next = _opened(self.path), 0
        return self._forward(number)

    def _forward(self, number: int) -> Image | None:
        for _ in range(number - self._next):
            if not self._capture.grab():
                return None
        self._next = number + 1
        return self._grab()


_SAID = "FRAME_WIDTH", "FRAME_HEIGHT", "FRAME_COUNT", "FPS", "FOURCC", "CODEC_PIXEL_FORMAT", "ORIENTATION_META"


def _opened(path: Path) -> Any:
    """A capture of a file; one thread decodes, so that a damaged frame is patched up the same way each time."""
    import cv2

    # Read when FFmpeg is first used in a process; without it FFmpeg writes on stderr what it meets in a file.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    options = [cv2.CAP_PROP_N_THREADS, 1, cv2.CAP_PROP_HW_ACCELERATION, cv2.VIDEO_ACCELERATION_NONE]
    place = os.path.abspath(path)  # FFmpeg takes "http:..." and the like for what is not a file
    with silence(), _errors(path):
        capture = cv2.VideoCapture(place, cv2.CAP_FFMPEG, options)
        if capture.isOpened():
            capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
            return capture
        raw = _undecoded(path)
        codec = _fourcc(raw.get(cv2.CAP_PROP_FOURCC)) if raw.isOpened() else None
    raise bad_input(path, unreadable(path, codec), EXPECTED)


def _undecoded(path: Path) -> Any:
    """A capture of a file's packets, for which no decoder is needed."""
    import cv2

    return cv2.VideoCapture(os.path.abspath(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])


def _fourcc(code: float) -> str:
    """Four characters of a code."""
    return (int(code) & 0xFFFFFFFF).to_bytes(4, "little").decode("latin-1") if code else "unknown"


def _mark(pixels: Image) -> int:
    return zlib.crc32(pixels[::_ROWS].tobytes())


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Keep OpenCV from writing on stderr."""
    import cv2

    global _silent, _level
    log: Any = getattr(cv2.utils, "logging", cv2)  # where it is depends on the version
    with _quiet_lock:
        _level = log.setLogLevel(_LOG_NOTHING) if not _silent else _level
        _silent += 1
    try:
        yield
    finally:
        with _quiet_lock:
            _silent -= 1
            if not _silent:
                log.setLogLevel(_level)


@contextlib.contextmanager
def _errors(path: Path) -> Iterator[None]:
    """Turn what OpenCV raises into the one line about a file."""
    import cv2

    try:
        yield
    except InputError as error:
        raise error if str(error).startswith(str(path)) else bad_input(path, str(error), EXPECTED) from error
    except (cv2.error, UnicodeError, ValueError, SystemError, OverflowError, MemoryError) as error:
        raise bad_input(path, f"cannot be decoded ({reason_of(error)})", EXPECTED) from error
