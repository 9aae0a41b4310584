"""A run in the browser: served by this process (``tspslam view``), or by one of its own beside a run (``--view``)."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
import os
import signal
import struct
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from .._files import PathLike, one_line
from ..errors import InputError
from ..frame import Frame
from ..types import Rig
from ..view.live._server import MISSING

if TYPE_CHECKING:
    from ..view.live.viewer import Viewer

HOST, PORT = "127.0.0.1", 8080
_HEAD = struct.Struct("<II")  # bytes of the words and of the image of a message
_LARGEST = 1 << 24  # bytes of either: more is no message of ours
_SECONDS = 0.1  # between two frames that are handed on
_REST = 15.0  # times what the last look took, before the next one beside a run: a viewer takes 1/16 of a processor
_WAITING = 4  # frames that may wait to be sent; of more the oldest go
_GRACE = 3.0  # s that a viewer has to end
_NICE = 19  # steps that the viewer stands behind the run where both want a processor
_WIDTH = 480  # px of an image that is handed on

OnFrame = Callable[[Frame], object]


def require_viser() -> None:
    """Raise `InputError` if viser is not installed.

    Raises
    ------
    InputError
        Which says how to install it.
    """
    if importlib.util.find_spec("viser") is None:
        raise InputError(MISSING)


def serve(
    folder: PathLike, *, host: str = HOST, port: int = PORT, frame: int | None = None,
    say: Callable[[str], None] = print, shots: Shots | None = None,
) -> None:  # fmt: skip
    """Show a run folder in the browser, and follow it, until the process is interrupted.

    Parameters
    ----------
    folder : str or path
        A run folder, finished or not, or where one will be.
    host : str
        Address to listen at; from another machine than this one, a token is needed.
    port : int
        The first port to try.
    frame : int, optional
        Number of the frame whose own mesh is shown first; by default the map.
    say : callable, str -> None
        Takes the address, and lines about what cannot be shown.
    shots : Shots, optional
        Frames of a run that goes on; where they end, the viewer does.

    Raises
    ------
    InputError
        If viser is not installed, nothing in the folder can be shown, or it has no such frame.
    OutputError
        If there is no free port.
    """
    require_viser()
    from .watch import RunWatch  # with matplotlib, which a run without a viewer needs at its end only

    watch = RunWatch(folder)
    world = watch.look()
    assert world is not None
    if shots is None and world.missing and not world.stored and world.map_ is None:
        raise InputError(world.missing[0])
    if frame is not None and frame not in world.stored:
        raise InputError(one_line(f"{folder}: has no stored frame {frame}, expected one of {list(world.stored)[:20]}"))
    from ..view.live.viewer import Viewer

    said: set[str] = set()

    def say_once(line: str) -> None:
        if line not in said:
            said.add(line)
            say(line)

    viewer = Viewer(watch.frame, host=host, port=port, frame=frame, complain=lambda line: say_once(f"warning: {line}"))
    try:
        for line in viewer.remarks:
            say(line)
        say(f"viewer: {viewer.address}")
        if shots is None and not world.stored and world.map_ is None:
            say(world.said)
        while shots is None or not shots.is_over:
            began = time.monotonic()
            if world is not None:
                for line in world.missing:
                    say_once(f"warning: {line}")
                viewer.show(world)
            if shots is None:
                viewer.work(3 * _SECONDS)
            else:
                _rest(viewer, shots, _REST * (time.monotonic() - began))
            world = watch.look()
    finally:
        viewer.close()


def _rest(viewer: Viewer, shots: Shots, seconds: float) -> None:
    """Leave the processor to the run for so long, and while nobody looks; the newest frame is shown as it comes."""
    end = time.monotonic() + seconds
    while not shots.is_over:
        if (shot := shots.newest()) is not None:
            viewer.show_shot(shot)
        viewer.work(_SECONDS)
        if viewer.is_watched and time.monotonic() >= end:
            return


@contextlib.contextmanager
def until_interrupted() -> Iterator[None]:
    """End a block at ctrl-C or SIGTERM as if it had come to its end.

    Yields
    ------
    None
    """

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        with contextlib.suppress(KeyboardInterrupt):
            yield
    finally:
        signal.signal(signal.SIGTERM, before)


class Shots:
    """Frames of a run that another process sends; only the newest counts.

    Parameters
    ----------
    source : raw binary file
        Where they come from; at its end, so is the run's process.
    """

    def __init__(self, source: io.RawIOBase) -> None:
        self.is_over = False
        self._source, self._lock = source, threading.Lock()
        self._newest: Any = None
        threading.Thread(target=self._read, daemon=True).start()

    def newest(self) -> Any:
        """Take the newest frame, if one came since the last call.

        Returns
        -------
        Shot or None
        """
        with self._lock:
            shot, self._newest = self._newest, None
        return shot

    def _read(self) -> None:
        from ..view.live.viewer import Shot

        while len(head := self._exactly(_HEAD.size)) == _HEAD.size:
            sizes = _HEAD.unpack(head)
            if max(sizes) > _LARGEST:
                break
            words, jpeg = (self._exactly(size) for size in sizes)
            if len(jpeg) < sizes[1]:
                break
            told = json.loads(words)
            pose, rig = np.array(told["T_world_camera"]).reshape(4, 4), Rig(**told["rig"])
            with self._lock:
                self._newest = Shot(told["number"], pose, told["state"], jpeg, rig)
        self.is_over = True

    def _exactly(self, size: int) -> bytes:
        """So many bytes; fewer at the end. Without Python's buffer, whose lock a process could not leave at its end."""
        data = b""
        while len(data) < size and (block := self._source.read(size - len(data))):
            data += block
        return data


def shots_from_stdin() -> Shots:
    """Be the viewer beside a run, which goes first.

    Returns
    -------
    Shots
        What the run's process sends.
    """
    if hasattr(os, "nice"):
        os.nice(_NICE)
    return Shots(open(0, "rb", buffering=0, closefd=False))


class Viewing:
    """What a run calls with each frame, for a viewer beside it: see `viewing`."""

    def __init__(self, folder: Path, host: str, port: int) -> None:
        self._last, self._is_over = 0.0, False
        self._waiting: deque[Frame] = deque(maxlen=_WAITING)
        self._came = threading.Condition()
        self._process = _start(folder, host, port)
        self._sender = threading.Thread(target=self._send, daemon=True)
        self._sender.start()

    def __call__(self, frame: Frame) -> None:
        """Hand a frame on; nothing is waited for.

        Parameters
        ----------
        frame : Frame
            Of which pose and image are shown.
        """
        now = time.monotonic()
        if now - self._last >= _SECONDS and frame.image is not None:
            self._last = now
            with self._came:
                self._waiting.append(frame)
                self._came.notify()

    def stay(self) -> None:
        """Go on serving what the run has left until ctrl-C, where somebody is there to press it: on a terminal."""
        if not all(stream is not None and stream.isatty() for stream in (sys.stdin, sys.stderr)):
            return
        with until_interrupted():
            self._process.wait()

    def close(self) -> None:
        """End the viewer, whatever state it is in."""
        self._is_over = True
        with self._came:
            self._came.notify()
        for end in (self._process.terminate, self._process.kill):
            with contextlib.suppress(OSError):
                end()
            try:
                self._process.wait(_GRACE)
            except subprocess.TimeoutExpired:
                continue
            break
        self._sender.join()  # which cannot be writing: nobody reads

    def _send(self) -> None:
        """Encode and send what waits, as fast as the viewer takes it."""
        pipe = self._process.stdin
        assert pipe is not None
        with pipe, contextlib.suppress(BrokenPipeError):  # the viewer is gone: the run goes on
            while (frame := self._next()) is not None:
                data = _packed(frame)
                while data:
                    data = data[pipe.write(data) :]

    def _next(self) -> Frame | None:
        """Wait for a frame; None at the end."""
        with self._came:
            while not self._waiting and not self._is_over:
                self._came.wait()
            return None if self._is_over else self._waiting.popleft()


def _packed(frame: Frame) -> bytes:
    """One frame as a message."""
    from ..view.live._images import jpeg_of, shrunk

    assert frame.image is not None
    rig = {name: getattr(frame.rig, name) for name in Rig.__dataclass_fields__}
    state = "lost" if frame.is_lost else "keyframe" if frame.is_keyframe else "tracked"
    told = {"number": frame.index, "T_world_camera": frame.T_world_camera.ravel().tolist(), "state": state, "rig": rig}
    step = max(1, frame.image.shape[1] // _WIDTH)
    words, jpeg = json.dumps(told).encode(), jpeg_of(shrunk(frame.image[::step, ::step], _WIDTH))
    return _HEAD.pack(len(words), len(jpeg)) + words + jpeg


def _start(folder: Path, host: str, port: int) -> subprocess.Popen[bytes]:
    """A viewer as a process of its own, which finds this package as this one does."""
    places = os.pathsep.join(each for each in sys.path if each)
    command = [sys.executable, "-P", "-m", "tspslam", "view", "--beside-run", "--host", host, "--port", str(port)]
    command += ["--", os.fspath(folder)]
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, bufsize=0, env=os.environ | {"PYTHONPATH": places}
    )


class _Nobody:
    """Where there is no viewer."""

    def __call__(self, frame: Frame) -> None:
        """Do nothing."""

    def stay(self) -> None:
        """Do not wait."""


class _Session(contextlib.AbstractContextManager["Viewing"]):
    def __init__(self, folder: Path, host: str, port: int) -> None:
        self._given = folder, host, port

    def __enter__(self) -> Viewing:
        self._viewing = Viewing(*self._given)
        return self._viewing

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._viewing.close()


def viewing(folder: PathLike | None, *, host: str = HOST, port: int = PORT) -> Any:
    """Open a viewer beside a run, in a process of its own; the run never waits for it, and ends as without it.

    Parameters
    ----------
    folder : str or path or None
        The run folder, which need not be there yet; None for no viewer.
    host : str
        Address to listen at.
    port : int
        The first port to try.

    Returns
    -------
    context manager
        Its value is the ``on_frame`` of `tspslam.run.pipeline.run`, and has a method ``stay()``: on a terminal, the
        finished run is shown until ctrl-C. The viewer ends with the block.

    Raises
    ------
    InputError
        If viser is not installed.
    """
    if folder is None:
        return contextlib.nullcontext(_Nobody())
    require_viser()
    return _Session(Path(folder), host, port)
