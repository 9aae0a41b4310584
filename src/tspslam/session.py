"""One pair after another: the place where the two wings meet."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cached_property, wraps
from threading import RLock
from typing import Any, TypeVar

from ._checks import require
from .errors import InputError
from .settings import Settings as Settings
from .topology.complex import Complex, build_complex
from .topology.texture import sample_signals
from .types import Cloud, FloatArray, Image, Response, Rig, Signals, StereoPair, Surface, Trajectory
from .vision.rig import require_baseline
from .vision.slam.odometry import StereoOdometry
from .vision.slam.tracking import Tracked
from .vision.stereo.reconstruct import Stereo, StereoQuality, match_stereo

T = TypeVar("T")


def _once(stage: Callable[[Frame], T]) -> Callable[[Frame], T]:
    """Compute `stage` when it is first asked for, whichever thread asks; what it raised is raised at each ask."""

    @wraps(stage)
    def result(self: Frame) -> T:
        name = stage.__name__
        with self._lock:
            if name in self._failed:
                raise self._failed[name]
            if name not in self._done:
                self._done[name] = self._attempt(name, stage)
            done: T = self._done[name]
            return done

    return result


class Frame:
    """All that one pair gave: where it was taken, and what is seen from there.

    What is not yet there is computed when it is asked for; of keyframes all is, from the start, in a thread of its own.

    Parameters
    ----------
    pair : StereoPair
        The images and their rig.
    tracked : Tracked
        Where they were taken.
    settings : Settings
        The stages.

    Attributes
    ----------
    pair, tracked, settings
        As given.
    seconds : dict
        Time that each stage took, s; varies from run to run.
    """

    def __init__(self, pair: StereoPair, tracked: Tracked, settings: Settings) -> None:
        self.pair, self.tracked, self.settings = pair, tracked, settings
        self.seconds = dict(tracked.seconds)
        self._done: dict[str, Any] = {}
        self._failed: dict[str, Exception] = {}
        self._lock = RLock()

    @property
    def T_world_camera(self) -> FloatArray:
        """Pose of the left camera as it was tracked, (4, 4); the world is the first frame's camera."""
        return self.tracked.T_world_camera

    @property
    def is_keyframe(self) -> bool:
        """Whether the map rests on it."""
        return self.tracked.is_keyframe

    @property
    @_once
    def stereo(self) -> Stereo:
        """What both images show: keypoints, points, quality."""
        return self.tracked.stereo or self._timed(
            "points", lambda: match_stereo(self.pair, self.settings.detector, self.settings.matcher)
        )

    @property
    def cloud(self) -> Cloud:
        """Points that both cameras see, in the left camera's frame."""
        return self.stereo.cloud

    @property
    def quality(self) -> StereoQuality:
        """How well the two images matched."""
        return self.stereo.quality

    @property
    @_once
    def surface(self) -> Surface:
        """Triangles over the points."""
        return self._timed("surface", lambda: self.settings.surface(self.cloud))

    @property
    @_once
    def complex_(self) -> Complex:
        """The simplicial complex of these."""
        faces, n = self.surface.faces, len(self.cloud)
        return self._timed("complex", lambda: build_complex(faces, n))

    @property
    @_once
    def signals(self) -> Signals:
        """Luminance on vertices, edges and faces."""
        complex_ = self.complex_
        return self._timed("signals", lambda: sample_signals(self.pair.left, self.cloud.uv, complex_))

    @property
    @_once
    def response(self) -> Response:
        """The filter's answer at each vertex."""
        complex_, signals = self.complex_, self.signals
        return self._timed("response", lambda: self.settings.filter(complex_, self.cloud.uv, signals))

    def _attempt(self, name: str, stage: Callable[[Frame], T]) -> T:
        """Run a stage, which may be the user's own, and remember what it raises."""
        try:
            return stage(self)
        except Exception as error:
            self._failed[name] = error
            raise

    def _timed(self, name: str, stage: Callable[[], T]) -> T:
        started = time.perf_counter()
        result = stage()
        self.seconds[name] = time.perf_counter() - started
        return result

    @property
    def index(self) -> int:
        """Place in its sequence."""
        return self.pair.index

    @property
    def stamp(self) -> float:
        """Time, s."""
        return self.pair.stamp

    @property
    def name(self) -> str:
        """What to call it."""
        return self.pair.name

    @property
    def rig(self) -> Rig:
        """The cameras."""
        return self.pair.rig

    @property
    def image(self) -> Image:
        """The left image."""
        return self.pair.left


class Session:
    """A rig, settings, and the pairs that it processes one after another: frames of one path.

    Threads that call `process`, `finish` or `close` of one session wait for each other.

    Parameters
    ----------
    rig : Rig
        The cameras of all pairs.
    settings : Settings, optional
        Stages; the defaults serve.

    Attributes
    ----------
    rig, settings
        As given.
    odometry : Odometry
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

    def __init__(self, rig: Rig, settings: Settings | None = None) -> None:
        require_baseline(rig, "session")
        self.rig = rig
        self.settings = settings or Settings()
        require(self.settings, Settings, "settings")
        stages = self.settings
        self.odometry = StereoOdometry(rig, detector=stages.detector, matcher=stages.matcher, tracking=stages.tracking)
        self._worker = ThreadPoolExecutor(1)
        self._busy: Future[Any] | None = None
        self._is_closed = False
        self._lock = RLock()

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
        frame = Frame(pair, self.odometry.process(pair), self.settings)
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
            self._worker.shutdown()
            self.odometry.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _wait(self) -> None:
        """Wait for the frame whose response is being computed, if any."""
        if self._busy:
            wait([self._busy])
