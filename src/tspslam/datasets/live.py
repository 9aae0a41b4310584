"""Cameras that are plugged in: pairs as they come, each recorded before it is handed on."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .._atomic import bad_output, make_folder
from .._checks import require_path
from .._files import PathLike, bad_input, one_line
from ..io.images import read_image
from ..types import FloatArray, Image, RawRig, Rig, StereoPair
from ..vision.calibration.formats import read_stereo
from ..vision.calibration.formats.own import save_cameras
from ._cameras import Capture, frame_size, ids_of, is_image, open_all, open_camera
from ._pairing import checked_index
from ._reader import Reader
from ._stereo_layouts import half_size, halves
from ._video import silence
from .video import calibration_of

_HELD = 64  # frames that may wait to be recorded: two seconds of most cameras
_AHEAD = 8  # recorded frames that may wait to be tracked; then the oldest is left out
_COMPRESSION = 1  # of PNG: the fastest; level 6 makes files a tenth smaller in five times the time
_NAP = 0.2  # s between two looks at whether the source was stopped
_PATIENCE = 12.0  # s to wait for a camera that gives nothing: OpenCV itself gives up after 10


@dataclass(frozen=True)
class _Taken:
    """A recorded pair: its number in the recording, its time (s), its images until the next is taken."""

    number: int
    stamp: float
    images: tuple[Image, Image] | None


class LiveSequence:
    """Pairs of a stereo camera, or of two cameras, as they come.

    Every pair is recorded, without loss, before it is handed on: `recording` becomes a folder with ``left/``,
    ``right/`` (PNG), ``times.txt`` (name and time, s, of each pair) and ``calib.yaml``, which `StereoFolder` reads.
    Where whoever asks for pairs is slower than the camera, the oldest that wait are left out, and counted; the
    recording has them. Two cameras are read one right after the other: only a common trigger makes their images those
    of one moment.

    Parameters
    ----------
    cameras : int or str, or two of them
        Numbers of cameras, such as 0, or their devices, ``/dev/video0``: one with both images, or a left and a right
        one. They are asked for images of the calibration's size.
    layout : str, optional
        Of one camera: ``"side-by-side"`` or ``"over-under"``.
    calib : str, path, Rig or RawRig
        Calibration of each image, with its size. Raw pairs are rectified.
    recording : str or path
        Folder to record into; new or empty.
    open_capture : callable, optional
        Called with the number or device of a camera and the (width, height) to ask for, px; returns an object with
        the interface of OpenCV's ``VideoCapture``. OpenCV's own by default.

    Attributes
    ----------
    rig : Rig
        The cameras of the rectified pairs.
    recorded, dropped, missed : int
        Pairs so far: recorded, of these left out since nobody was ready for them, and lost since the disk was slower
        than the camera.
    ended_early : bool
        Whether a camera stopped giving images before the source was stopped.

    Raises
    ------
    InputError
        If a camera cannot be opened or gives no image, the layout or the calibration does not fit, or the folder is
        not empty.
    OutputError
        If the folder cannot be written to.

    Examples
    --------
    >>> LiveSequence("no-such-camera", calib="calib.yaml", recording="drive")
    Traceback (most recent call last):
    tspslam.errors.InputError: layout is None, expected 'side-by-side' or 'over-under' of one camera, or two cameras
    """

    rig: Rig

    def __init__(
        self, cameras: int | str | Sequence[int | str], layout: str | None = None, *,
        calib: PathLike | Rig | RawRig, recording: PathLike,
        open_capture: Callable[[int | str, tuple[int, int]], Capture] | None = None,
    ) -> None:  # fmt: skip
        self._ids, self.layout = ids_of(cameras, layout), layout
        require_path(recording, "recording")
        self.recording = Path(recording)
        known = _known(calib)
        self._captures = open_all(self._ids, frame_size(known, layout), open_capture or open_camera)
        try:
            calibration_of(known, self._size_of_first())
            _check_new(self.recording)
        except BaseException:
            self._release()
            raise
        self._names: list[str] = []
        self._cameras = known
        self._reader = Reader(known, self._images, self._names)
        self.rig = self._reader.rig
        self._taken: list[_Taken] = []
        self._waiting: deque[_Taken] = deque()
        self._held: deque[tuple[float, list[Image]]] = deque()
        self._changed, self._stop = threading.Condition(), threading.Event()
        self._threads: list[threading.Thread] = []
        self.recorded = self.dropped = self.missed = 0
        self.ended_early = False
        self._is_over = self._is_grabbed = False
        self._failure: Exception | None = None

    @property
    def name(self) -> str:
        """What to call it: ``camera-0``, or ``camera-0-2``."""
        return one_line("camera-" + "-".join(Path(str(each)).name for each in self._ids))

    @property
    def stamps(self) -> FloatArray:
        """Times of the pairs handed on so far, s, from the first one recorded."""
        return np.array([each.stamp for each in self._taken], np.float64)

    @property
    def warnings(self) -> list[dict[str, str]]:
        """What is to be said of the pairs so far, each a ``code`` and a ``message``."""
        said = []
        if self.ended_early:
            message = f"{self.name}: gave no more images after {self.recorded} pairs"
            said.append({"code": "camera_lost", "message": message})
        if self.dropped:
            way = f"tspslam run {one_line(str(self.recording))} takes all"
            message = f"{self.dropped} of {self.recorded} recorded pairs were not tracked: {way}"
            said.append({"code": "frames_dropped", "message": message})
        if self.missed:
            message = f"{self.missed} pairs were not recorded: the disk is slower than the camera"
            said.append({"code": "frames_missed", "message": message})
        return said

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, {len(self)} pairs)"

    def __len__(self) -> int:
        """How many pairs were handed on so far."""
        return len(self._taken)

    def __getitem__(self, index: int) -> StereoPair:
        """Read a pair that was handed on; an earlier one from the recording."""
        index = checked_index(index, len(self))
        return replace(self._reader.read(index), stamp=self._taken[index].stamp)

    def wait_for(self, index: int) -> bool:
        """Wait until a pair is there; the first call begins the recording.

        Parameters
        ----------
        index : int
            From 0: one that was handed on, or the next.

        Returns
        -------
        bool
            False if it will never be: the source was stopped, or a camera gives nothing more.

        Raises
        ------
        OutputError
            If the recording cannot be written.
        """
        self._start()
        with self._changed:
            while index >= len(self._taken):
                if self._waiting:
                    self._take(self._waiting.popleft())
                elif self._is_over:
                    if self._failure:
                        raise self._failure
                    return False
                elif self._is_silent():
                    self.ended_early = not self._stop.is_set()
                    self._stop.set()
                    return False
                else:
                    self._changed.wait(_NAP)
        return True

    def _is_silent(self) -> bool:
        """Whether a camera hangs: it neither gives an image nor says that there is none."""
        return not self._is_grabbed and time.monotonic() - self._heard > _PATIENCE

    def stop(self) -> None:
        """Take no more images; pairs that wait are still handed on."""
        self._stop.set()

    def close(self) -> None:
        """Stop, and let go of the cameras once all is recorded."""
        self.stop()
        for thread in self._threads:
            thread.join(_PATIENCE)
            with self._changed:
                self._is_grabbed = True  # by a camera that hangs too
                self._changed.notify_all()
        self._release()

    def _take(self, taken: _Taken) -> None:
        if self._taken:
            self._taken[-1] = replace(self._taken[-1], images=None)
        self._names.append(f"{taken.number:06d}")
        self._taken.append(taken)

    def _images(self, index: int) -> Iterator[Image]:
        taken = self._taken[index]
        return iter(taken.images or [read_image(path) for path in self._files(taken.number)])

    def _files(self, number: int) -> tuple[Path, Path]:
        return self.recording / "left" / f"{number:06d}.png", self.recording / "right" / f"{number:06d}.png"

    def _start(self) -> None:
        if not self._threads:
            self._heard = time.monotonic()
            self._threads = [threading.Thread(target=each, daemon=True) for each in (self._grab_all, self._record_all)]
            for thread in self._threads:
                thread.start()

    def _grab_all(self) -> None:
        """Take images until the source is stopped or a camera gives none."""
        try:
            while not self._stop.is_set():
                images = self._grab()
                if images is None:
                    self.ended_early = not self._stop.is_set()
                    break
                with self._changed:
                    self._heard = images[0]
                    if len(self._held) < _HELD:
                        self._held.append(images)
                    else:
                        self.missed += 1
                    self._changed.notify_all()
        finally:
            with self._changed:
                self._is_grabbed = True
                self._changed.notify_all()

    def _grab(self) -> tuple[float, list[Image]] | None:
        """Images of one moment and its time; None where a camera gives none."""
        with silence():
            try:
                if not all(capture.grab() for capture in self._captures):
                    return None
                now = time.monotonic()
                found = [capture.retrieve() for capture in self._captures]
            except Exception:  # whatever the library of a camera raises, it gives nothing more
                return None
        is_whole = all(there and is_image(image) for there, image in found)
        return (now, [image for _, image in found]) if is_whole else None

    def _record_all(self) -> None:
        """Record what was taken, and hand it on."""
        try:
            held = self._next_held()
            if held is None:
                return
            _prepare(self.recording, self._cameras)
            with open(self.recording / "times.txt", "w", encoding="ascii") as times:
                start = None
                while held is not None:
                    start = held[0] if start is None else start
                    self._record(times, held[0] - start, _sides(held[1], self.layout))
                    held = self._next_held()
        except OSError as error:
            self._failure = bad_output(self.recording / "times.txt", error)
        except Exception as error:
            self._failure = error  # raised where the next pair is waited for
        finally:
            self._stop.set()
            with self._changed:
                self._is_over = True
                self._changed.notify_all()

    def _next_held(self) -> tuple[float, list[Image]] | None:
        with self._changed:
            while not self._held:
                if self._is_grabbed:
                    return None
                self._changed.wait(_NAP)
            return self._held.popleft()

    def _record(self, times: Any, stamp: float, images: tuple[Image, Image]) -> None:
        files = self._files(self.recorded)
        times.write(f"{files[0].name} {stamp:.9f}\n")  # before its images: where one is killed, no image lacks a time
        times.flush()
        for path, image in zip(files, images, strict=True):
            part = path.with_suffix(".part")
            part.write_bytes(_png(image))  # not synced to disk one by one, which takes longer than a frame does
            part.replace(path)
        with self._changed:
            self._waiting.append(_Taken(self.recorded, round(stamp, 9), images))
            self.recorded += 1
            if len(self._waiting) > _AHEAD:
                self._waiting.popleft()
                self.dropped += 1
            self._changed.notify_all()

    def _size_of_first(self) -> tuple[int, int]:
        """Size of each image of the first pair, which is looked at and left out."""
        first = self._grab()
        if first is None:
            raise bad_input(self.name, "gives no image", "a camera that does, and that no other program uses")
        sizes = {(image.shape[1], image.shape[0]) for image in first[1]}
        if len(sizes) > 1:
            said = " and ".join(f"{width} x {height}" for width, height in sorted(sizes))
            raise bad_input(self.name, f"give images of {said} px", "two cameras of one size")
        return half_size(sizes.pop(), self.layout, self.name)

    def _release(self) -> None:
        for capture in self._captures:
            capture.release()


def _known(calib: PathLike | Rig | RawRig) -> Rig | RawRig:
    return calib if isinstance(calib, Rig | RawRig) else read_stereo(calib)


def _check_new(recording: Path) -> None:
    """Refuse the folder of a recording that is there."""
    if recording.exists() and (not recording.is_dir() or any(recording.iterdir())):
        way = f"a new folder; tspslam run {one_line(str(recording))} takes what is recorded there"
        raise bad_input(recording, "is there already", way)


def _prepare(recording: Path, cameras: Rig | RawRig) -> None:
    """Make the folder of a recording."""
    for side in ("left", "right"):
        make_folder(recording / side)
    save_cameras(cameras, recording / "calib.yaml")


def _sides(frames: list[Image], layout: str | None) -> tuple[Image, Image]:
    """Left and right image of what was taken, grey or RGB."""
    import cv2

    plain: list[Any] = [cv2.cvtColor(each, cv2.COLOR_BGR2RGB) if each.ndim == 3 else each for each in frames]
    left, right = halves(plain[0], layout) if layout else (plain[0], plain[1])
    return left.copy(), right.copy()  # each in one piece


def _png(image: Image) -> bytes:
    import cv2

    stored = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    made: bytes = cv2.imencode(".png", stored, [cv2.IMWRITE_PNG_COMPRESSION, _COMPRESSION])[1].tobytes()
    return made
