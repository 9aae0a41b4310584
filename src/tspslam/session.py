"""One pair after another: the place where the two wings meet."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, wait
from functools import cached_property
from threading import RLock
from typing import Any, Protocol, TypeVar

from numpy.typing import NDArray

from ._checks import require, told
from ._threads import Worker
from .errors import InputError
from .frame import Frame, Once
from .settings import Settings as Settings
from .topology.complex import build_complex
from .topology.texture import sample_signals
from .types import FloatArray, Image, Rig, StereoPair, Trajectory
from .vision.rig import require_baseline
from .vision.slam.odometry import StereoOdometry
from .vision.slam.tracking import Tracked
from .vision.stereo.reconstruct import Stereo, match_stereo

T = TypeVar("T")


class Landmarks(Protocol):
    """The map that an odometry tracks its camera in."""

    @property
    def xyz(self) -> FloatArray:
        """Positions in the world, (L, 3), m."""


class Odometry(Protocol):
    """What tells a session where each pair was taken; `tspslam.vision.slam.odometry` has the one of stereo images."""

    @property
    def trajectory(self) -> Trajectory:
        """Poses of all frames so far, as all that was seen since has bettered them."""

    @property
    def map(self) -> Landmarks:
        """What the camera is tracked in."""

    @property
    def disparity_offset(self) -> tuple[float, float]:
        """Measured less true disparity, px, and its standard deviation."""

    @property
    def loops(self) -> int:
        """How often the map was corrected because a place was seen again."""

    @property
    def unsolved(self) -> int:
        """Adjustments of the map that had no solution."""

    def process(self, pair: StereoPair) -> Tracked:
        """Where the next pair was taken; `InputError` if it cannot be used.

        Parameters
        ----------
        pair : StereoPair
            Not earlier than the last one.

        Returns
        -------
        Tracked
        """

    def finish(self) -> None:
        """Make the trajectory final."""

    def close(self) -> None:
        """Let go of threads; no further pair can be processed."""

    def state(self) -> dict[str, NDArray[Any]]:
        """All that the next frame depends on.

        Returns
        -------
        dict of str to array
        """

    def restore(self, state: Mapping[str, NDArray[Any]], image_of: Callable[[int], Image]) -> None:
        """Go on from a state.

        Parameters
        ----------
        state : dict of str to array
            As `state` gave it.
        image_of : callable
            Left image of a frame by its number, from 0.
        """


class Session:
    """A rig, settings, and the pairs that it processes one after another: frames of one path.

    Threads that call `process`, `finish` or `close` of one session wait for each other.

    Parameters
    ----------
    rig : Rig
        The cameras of all pairs.
    settings : Settings, optional
        Stages; the defaults serve.
    odometry : session.Odometry, optional
        What tells where each pair was taken, if not the two images: wheels, say. Its `state` is its own: runs go on
        from checkpoints of the stereo odometry alone.

    Attributes
    ----------
    rig, settings
        As given.
    odometry : session.Odometry
        The map and the path so far.

    Examples
    --------
    >>> from tspslam import datasets
    >>> pair = datasets.motorcycle()
    >>> with Session(pair.rig) as session:
    ...     frame = session.process(pair)
    ...     path = session.finish()
    >>> len(frame.response.z) == len(frame.cloud), len(path)
    (True, 1)
    """

    def __init__(self, rig: Rig, settings: Settings | None = None, *, odometry: Odometry | None = None) -> None:
        require_baseline(rig, "session")
        self.rig = rig
        self.settings = settings or Settings()
        require(self.settings, Settings, "settings")
        self.odometry = _stereo_odometry(rig, self.settings) if odometry is None else _checked(odometry)
        self._worker = Worker()
        self._busy: Future[Any] | None = None
        self._is_closed = False
        self._lock = RLock()

    def __repr__(self) -> str:
        closed = ", closed" if self._is_closed else ""
        return f"Session({self.rig.width} x {self.rig.height} px, {self.odometry!r}{closed})"

    @cached_property
    def fingerprints(self) -> tuple[str, ...]:
        """Hashes of the files that stages read, such as a network's; read once."""
        return tuple(getattr(stage, "fingerprint", "") for stage in vars(self.settings).values())

    @property
    def trajectory(self) -> Trajectory:
        """Poses of all frames so far, bettered by all that was seen since; `finish` makes them final."""
        return self.odometry.trajectory

    def process(self, pair: StereoPair) -> Frame:
        """From the next pair of images to its pose and, at keyframes, to the harmonic response at every point.

        Parameters
        ----------
        pair : StereoPair
            Of this session's rig, not earlier than the last one.

        Returns
        -------
        Frame

        Raises
        ------
        InputError
            If the pair is of another rig, earlier than the last one, or its images do not fit; or after `close`.
        GeometryError
            If it is the first and shows too little texture for three points.
        """
        require(pair, StereoPair, "pair")
        if pair.rig != self.rig:
            raise InputError(f"{pair.name}: its rig is {pair.rig}, expected the session's {self.rig}")
        with self._lock:
            return self._process(pair)

    def _process(self, pair: StereoPair) -> Frame:
        if self._is_closed:
            raise InputError(f"{pair.name}: the session is closed, expected an open one")
        frame = _build_frame(pair, self.odometry.process(pair), self.settings)
        if frame.is_keyframe or self.settings.tracking.every_frame:
            self._wait()  # so that no more than one frame waits
            self._busy = self._worker.submit(getattr, frame, "response")  # what fails is raised when it is asked for
        return frame

    def finish(self) -> Trajectory:
        """Adjust all keyframes together, and return the path: from here on it is final.

        Returns
        -------
        Trajectory
            Poses of all frames.
        """
        with self._lock:
            self._wait()
            self.odometry.finish()
            return self.trajectory

    def close(self) -> None:
        """Let the worker threads go; no further pair can be processed. Leaving a ``with`` block does that."""
        with self._lock:
            self._is_closed = True
            self._worker.close()
            self.odometry.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _wait(self) -> None:
        """Wait for the frame whose response is being computed, if any."""
        if self._busy:
            wait([self._busy])


def _stereo_odometry(rig: Rig, stages: Settings) -> StereoOdometry:
    return StereoOdometry(rig, detector=stages.detector, matcher=stages.matcher, tracking=stages.tracking)


def _checked(odometry: Odometry) -> Odometry:
    """Refuse what lacks a part of an odometry, or is a class where an object of it goes."""
    wanted = {name for name in vars(Odometry) if not name.startswith("_")}
    lacking = sorted(wanted - set(dir(odometry)))  # which computes nothing
    if lacking or isinstance(odometry, type):
        found = repr(odometry)[:60] if isinstance(odometry, type) else f"{told(odometry)} without {lacking[0]}"
        raise InputError(f"odometry is {found}, expected an object with {', '.join(sorted(wanted))}")
    return odometry


def _build_frame(pair: StereoPair, tracked: Tracked, stages: Settings) -> Frame:
    """From the pose to points, surface, complex, signals, response: each computed when it is first asked for."""
    seconds = dict(tracked.seconds)

    def once(name: str, stage: Callable[[], T]) -> Once[T]:
        return Once(lambda: _timed(stage, name, seconds))

    def match() -> Stereo:
        known = tracked.stereo
        return match_stereo(pair, stages.detector, stages.matcher) if known is None else known

    stereo = once("points", match)
    surface = once("surface", lambda: stages.surface(stereo().cloud))
    complex_ = once("complex", lambda: build_complex(surface().faces, len(stereo().cloud)))
    signals = once("signals", lambda: sample_signals(pair.left, stereo().cloud.uv, complex_()))
    response = once("response", lambda: stages.filter(complex_(), stereo().cloud.uv, signals()))
    return Frame(
        pair.index, pair.stamp, pair.name, pair.rig, lambda: stereo().cloud, surface, complex_, signals, response,
        image=pair.left, T_world_camera=tracked.T_world_camera, landmark=lambda: tracked.landmarks_of(stereo().cloud),
        is_keyframe=tracked.is_keyframe, is_lost=tracked.is_lost, quality=lambda: stereo().quality, tracked=tracked,
        seconds=seconds,
    )  # fmt: skip


def _timed(stage: Callable[[], T], name: str, seconds: dict[str, float]) -> T:
    """Compute a stage and note its own time, less that of the stages that it asked for."""
    started, before = time.perf_counter(), sum(seconds.values())
    result = stage()
    within = sum(seconds.values()) - before
    seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - started - within
    return result
