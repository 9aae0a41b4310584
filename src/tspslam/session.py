"""One pair after another: the place where the two wings meet."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import fields, replace
from functools import cached_property
from threading import Lock, RLock
from typing import Any, Protocol, TypeVar

import numpy as np

from ._checks import require, told
from ._threads import Worker
from .errors import InputError, TspSlamError
from .frame import Frame, Once
from .settings import Settings as Settings
from .topology.complex import build_complex
from .topology.texture import sample_signals
from .types import Response, Rig, StereoPair, Surface, Trajectory
from .vision.images import PreparedPair, prepare
from .vision.rig import require_baseline
from .vision.slam.keyframes.keyframe import MapSnapshot
from .vision.slam.odometry import StereoOdometry
from .vision.slam.pose import Tracked
from .vision.stereo.reconstruct import Stereo, match_stereo

T = TypeVar("T")


class Odometry(Protocol):
    """What tells a session where each pair was taken: `StereoOdometry`, or wheels, say.

    Examples
    --------
    >>> import numpy as np
    >>> from tspslam import datasets
    >>> class Given:
    ...     def __init__(self, poses):
    ...         self.poses, self.stamps = poses, []
    ...     @property
    ...     def trajectory(self):
    ...         return Trajectory(np.array(self.stamps), self.poses[: len(self.stamps)])
    ...     def process(self, pair):
    ...         self.stamps.append(pair.stamp)
    ...         return Tracked(self.poses[len(self.stamps) - 1], is_keyframe=True)
    ...     def finish(self): pass
    ...     def close(self): pass
    >>> pair = datasets.motorcycle()
    >>> with Session(pair.rig, odometry=Given(np.eye(4)[None])) as session:
    ...     frame = session.process(pair)
    >>> frame.is_keyframe
    True
    """

    @property
    def trajectory(self) -> Trajectory:
        """Poses of all frames so far, as refined by all that was seen since."""

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


class Session:
    """A rig, settings, and the pairs that it processes one after another: frames of one path.

    Of keyframes, points, surface, complex, signals and response are computed at once, in a thread; of other frames when
    they are asked for.

    Threads that call `process`, `finish` or `close` of one session wait for each other. A process that is forked from
    another makes sessions of its own: threads do not come along.

    Parameters
    ----------
    rig : Rig
        The cameras of all pairs.
    settings : Settings, optional
        Stages; the defaults serve.
    odometry : Odometry, optional
        What tells where each pair was taken, if not the two images: wheels, say. Runs write checkpoints of the stereo
        odometry alone.
    keep : bool
        Whether keyframes are kept, with their images: `tspslam.build_map` makes the map of them.

    Attributes
    ----------
    rig, settings
        As given.
    odometry : Odometry
        The map and the path so far.
    keyframes : dict of int to Frame
        Those that are kept, by how many pairs were processed before; of those that the odometry's map rests on.

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

    def __init__(
        self, rig: Rig, settings: Settings | None = None, *, odometry: Odometry | None = None, keep: bool = True
    ) -> None:
        require_baseline(rig, "session")
        self.rig = rig
        self.settings = settings or Settings()
        require(self.settings, Settings, "settings")
        self.odometry = _stereo_odometry(rig, self.settings) if odometry is None else _require_odometry(odometry)
        if not isinstance(keep, bool):
            raise InputError(f"session: keep is {told(keep)}, expected True or False")
        self.keyframes: dict[int, Frame] = {}
        self._keeps, self._count = keep, 0
        self._worker, self._scout = Worker(), Worker()
        self._coming: PreparedPair | None = None
        if isinstance(self.odometry, StereoOdometry):
            self.odometry.foresight.on_due = lambda: self._detect_ahead(self._coming)
        self._busy: Future[Any] | None = None
        self._is_closed = self._is_final = False
        self._lock, self._ahead = RLock(), Lock()  # the latter for the pair that comes next

    def __repr__(self) -> str:
        closed = ", closed" if self._is_closed else ""
        return f"Session({self.rig.width} x {self.rig.height} px, {self.odometry!r}{closed})"

    @cached_property
    def fingerprints(self) -> tuple[str, ...]:
        """Hashes of the files that stages read, such as a network's; read once."""
        return tuple(getattr(stage, "fingerprint", "") for stage in vars(self.settings).values())

    @property
    def trajectory(self) -> Trajectory:
        """Poses of all frames so far, refined by all that was seen since; `finish` makes them final."""
        return self.odometry.trajectory

    def prepare(self, pair: StereoPair) -> StereoPair:
        """Make ready what a pair needs from no other: another thread may do that while the last one is processed.

        `process` takes what this gives as it is; results are the same.

        Parameters
        ----------
        pair : StereoPair
            Of this session's rig.

        Returns
        -------
        StereoPair
            With images of its own, smoothed planes and a pyramid. What is wrong with the pair is left to `process`.

        Examples
        --------
        >>> from tspslam import datasets
        >>> pair = datasets.motorcycle()
        >>> with Session(pair.rig) as session:
        ...     frame = session.process(session.prepare(pair))
        >>> frame.is_keyframe
        True
        """
        require(pair, StereoPair, "pair")
        if pair.rig != self.rig or not isinstance(self.odometry, StereoOdometry):
            return pair
        try:
            ready = prepare(_own(pair))
        except TspSlamError:
            return pair
        self.odometry.fill(ready)
        with self._ahead:
            self._coming = ready
        return ready

    def process(self, pair: StereoPair) -> Frame:
        """From the next pair of images to its pose and, at keyframes, to the harmonic response at every point.

        Parameters
        ----------
        pair : StereoPair
            Of this session's rig, not earlier than the last one.

        Returns
        -------
        Frame
            With images of its own: those of the pair may be written over. Its arrays are shared with what is still
            being computed and written: copy before you change them.

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

    def begin(self) -> None:
        """Begin a further recording with the next pair: it may be anywhere in the map, or in none of it.

        `StereoOdometry.begin` says what follows; where poses come from elsewhere, nothing does. Stamps go on rising:
        `tspslam.datasets.JoinedSequence` sees to that.

        Examples
        --------
        >>> from dataclasses import replace
        >>> from tspslam.datasets import synthetic
        >>> walk = synthetic.SyntheticSequence(synthetic.corridor(2.0))
        >>> with Session(walk.rig) as session:
        ...     frames = [session.process(pair) for pair in walk]
        ...     session.begin()
        ...     again = session.process(replace(walk[1], stamp=60.0))
        >>> bool(np.allclose(again.T_world_camera, walk.truth[1], atol=0.02))
        True
        """
        with self._lock:
            self._is_final = False
            if isinstance(self.odometry, StereoOdometry):
                self.odometry.begin()

    def _process(self, pair: StereoPair) -> Frame:
        if self._is_closed:
            raise InputError(f"{pair.name}: the session is closed, expected an open one")
        if not isinstance(pair, PreparedPair):
            pair = _own(pair)
        self._detect_ahead(pair)
        with self._ahead:
            self._coming = None if self._coming is pair else self._coming
        tracked = self.odometry.process(pair)
        self._is_final = False
        require(tracked, Tracked, "odometry: result")
        frame = _build_frame(_plain(pair), tracked, self.settings)
        if frame.is_keyframe or self.settings.tracking.every_frame:
            self._wait()  # so that no more than one frame waits
            ahead = self.odometry.mapper.adjustment if isinstance(self.odometry, StereoOdometry) else None
            self._busy = self._worker.submit(_respond, frame, ahead)
        if frame.is_keyframe and self._keeps:
            self._keep(frame)
        self._count += 1
        return frame

    def _detect_ahead(self, pair: StereoPair | None) -> None:
        """Have keypoints detected in a thread where those of the pair, the next one, are likely to be needed."""
        odometry = self.odometry
        if not isinstance(pair, PreparedPair) or not isinstance(odometry, StereoOdometry):
            return
        if odometry.foresight.is_due and self._scout.is_beside:
            self._scout.submit(odometry.detect, pair)  # what fails does so again when it is asked for

    @property
    def busy(self) -> Future[Any] | None:
        """What computes the points to the response of the last keyframe; None before the first one."""
        return self._busy

    def _keep(self, frame: Frame) -> None:
        """Keep a keyframe, and let go of those that the map rests on no more."""
        self.keyframes[self._count] = frame
        frames = self.odometry.map.keyframes if isinstance(self.odometry, StereoOdometry) else None
        if frames is not None and len(self.keyframes) > len(frames):  # some were culled, as now and then
            used = {keyframe.index for keyframe in frames}
            self.keyframes = {number: kept for number, kept in self.keyframes.items() if number in used}

    def capture(self) -> tuple[dict[int, Frame], MapSnapshot | None, Rig, Trajectory]:
        """Copy what a map is made of, as it is between two pairs; another thread may go on afterwards.

        Returns
        -------
        keyframes : dict of int to Frame
            As `keyframes`.
        snapshot : MapSnapshot or None
            Landmarks and their observations; None if the poses come from elsewhere.
        rig : Rig
            With the offset of the disparities that the path found.
        trajectory : Trajectory
            Poses so far.
        """
        with self._lock:
            frames, odometry = dict(self.keyframes), self.odometry
            if isinstance(odometry, StereoOdometry):
                return frames, odometry.map.snapshot(), odometry.map.rig, self.trajectory
            return frames, None, self.rig, self.trajectory

    def finish(self) -> Trajectory:
        """Adjust all keyframes together, once, and return the path: it is final until a further pair is processed.

        Returns
        -------
        Trajectory
            Poses of all frames.
        """
        with self._lock:
            if not self._is_final:
                self.odometry.finish()
                self._is_final = True
            self._wait()
            return self.trajectory

    def close(self) -> None:
        """Let the worker threads go; no further pair can be processed. Leaving a ``with`` block does that."""
        with self._lock:
            self._is_closed = True
            self._worker.close()
            self._scout.close()
            self.odometry.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _wait(self) -> None:
        """Wait for the frame whose response is being computed, if any."""
        if self._busy:
            wait([self._busy])


def _respond(frame: Frame, ahead: Future[Any] | None) -> None:
    """Compute a frame's response, after the adjustment that tracking will wait for: there may be two cores only."""
    if ahead is not None:
        wait([ahead])
    _ = frame.response  # what fails is raised when it is asked for


def _own(pair: StereoPair) -> StereoPair:
    """The pair with images of its own, where a camera may write the next ones into these."""
    images = {name: getattr(pair, name) for name in ("left", "right", "disparity", "sigma", "valid")}
    return replace(pair, **{n: image.copy() for n, image in images.items() if _may_change(image)})


def _plain(pair: StereoPair) -> StereoPair:
    """The pair without what was made of its images, which a frame need not hold."""
    return StereoPair(**{each.name: getattr(pair, each.name) for each in fields(StereoPair)})


def _may_change(image: object) -> bool:
    return isinstance(image, np.ndarray) and image.flags.writeable


def _stereo_odometry(rig: Rig, stages: Settings) -> StereoOdometry:
    return StereoOdometry(rig, detector=stages.detector, matcher=stages.matcher, tracking=stages.tracking)


def _require_odometry(odometry: Odometry) -> Odometry:
    """Refuse what lacks a part of an odometry, or is a class where an object of it goes."""
    wanted = {name for name in vars(Odometry) if not name.startswith("_")}
    lacking = sorted(wanted - set(dir(odometry)))  # which computes nothing
    if lacking or isinstance(odometry, type):
        found = repr(odometry)[:60] if isinstance(odometry, type) else f"{told(odometry)} without {lacking[0]}"
        raise InputError(f"odometry is {found}, expected an object with {', '.join(sorted(wanted))}")
    return odometry


def _checked(result: T, kind: type, stage: str) -> T:
    require(result, kind, f"settings: {stage}: result")
    return result


def _build_frame(pair: StereoPair, tracked: Tracked, stages: Settings) -> Frame:
    """From the pose to points, surface, complex, signals, response: each computed when it is first asked for."""
    seconds = dict(tracked.seconds)

    def once(name: str, stage: Callable[[], T]) -> Once[T]:
        return Once(lambda: _timed(stage, name, seconds))

    def match() -> Stereo:
        known = tracked.stereo
        return match_stereo(pair, stages.detector, stages.matcher) if known is None else known

    stereo = once("points", match)
    cloud = Once(lambda: stereo().cloud)
    surface = once("surface", lambda: _checked(stages.surface(cloud()), Surface, "surface"))
    complex_ = once("complex", lambda: build_complex(surface().faces, len(cloud())))
    signals = once("signals", lambda: sample_signals(pair.left, cloud().uv, complex_(), valid=pair.valid))
    response = once("response", lambda: _checked(stages.filter(complex_(), cloud().uv, signals()), Response, "filter"))
    return Frame(
        pair.index, pair.stamp, pair.name, pair.rig, cloud, surface, complex_, signals, response,
        image=pair.left, T_world_camera=tracked.T_world_camera, landmark=lambda: tracked.landmarks_of(cloud()),
        is_keyframe=tracked.is_keyframe, is_lost=tracked.is_lost, quality=lambda: stereo().quality, tracked=tracked,
        seconds=seconds, valid=pair.valid,
    )  # fmt: skip


def _timed(stage: Callable[[], T], name: str, seconds: dict[str, float]) -> T:
    """Compute a stage and note its own time, less that of the stages that it asked for."""
    started, before = time.perf_counter(), sum(seconds.values())
    result = stage()
    within = sum(seconds.values()) - before
    seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - started - within
    return result
