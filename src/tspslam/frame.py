"""One frame: where it was taken, and what is seen from there. The same type from a session, a file, or a mesh."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from threading import RLock
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ._checks import require, told
from .errors import InputError
from .types import BoolArray, Cloud, FloatArray, Image, Response, Rig, Signals, Surface

if TYPE_CHECKING:
    from .topology.complex import Complex
    from .vision.slam.pose import Tracked
    from .vision.stereo.reconstruct import StereoQuality

T = TypeVar("T")
_ABSENT: Any = object()


class Once(Generic[T]):
    """A value that is computed when it is first asked for, whichever thread asks.

    What the computation raised is raised at each ask. A pickle or a deep copy of it is the value.

    Parameters
    ----------
    compute : callable, () -> value
        Called once.

    Examples
    --------
    >>> dice = iter([4, 2])
    >>> thrown = Once(lambda: next(dice))
    >>> thrown(), thrown()
    (4, 4)
    """

    def __init__(self, compute: Callable[[], T]) -> None:
        self._compute: Callable[[], T] | None = compute
        self._lock = RLock()  # a computation may ask for its own value by mistake: an endless recursion, no deadlock
        self._error: Exception | None = None
        self._value: T = _ABSENT

    @property
    def value(self) -> T | None:
        """What was computed; None before it was."""
        return None if self._value is _ABSENT else self._value

    def __call__(self) -> T:
        """Return the value, or raise what its computation raised."""
        with self._lock:
            if self._compute is not None:
                self._run(self._compute)
            if self._error is not None:
                raise self._error
            return self._value

    def _run(self, compute: Callable[[], T]) -> None:
        """Compute, and let go of what the computation holds: images, say."""
        try:
            self._value = compute()
        except Exception as error:  # of a stage, which may be the user's own
            self._error = error
        self._compute = None

    def __reduce__(self) -> tuple[Any, ...]:
        return _itself, (self(),)


def _itself(value: T) -> T:
    return value


class Part(Generic[T]):
    """A field of a frozen dataclass that is given as a value, or as a function that computes it once.

    Parameters
    ----------
    default : value, optional
        What the field is where nothing is given.
    kind : type, optional
        What the value must be.
    """

    def __init__(self, default: T = _ABSENT, *, kind: type | None = None) -> None:
        self._default, self._kind = default, kind

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, frame: object | None, owner: type) -> T:
        if frame is None:  # `dataclass` asks for the default
            if self._default is _ABSENT:
                raise AttributeError(self._name)
            return self._default
        held = vars(frame)[self._name]
        value: T = held() if isinstance(held, Once) else held
        self._check(value)
        return value

    def __set__(self, frame: object, value: T | Callable[[], T]) -> None:
        if not callable(value):
            self._check(value)
        vars(frame)[self._name] = Once(value) if callable(value) and not isinstance(value, Once) else value

    def _check(self, value: object) -> None:
        if self._kind is not None:
            require(value, self._kind, f"frame: {self._name}")


@dataclass(frozen=True, eq=False, repr=False)
class Frame:
    """One frame: where it was taken, and what is seen from there.

    `Session.process`, `io.read_frame` and ``interop.from_...`` give one; files, pictures and reports take one. Each
    part (cloud, surface, complex, signals, response, landmark, quality) may be given as a value, or as a function that
    computes it when it is first asked for, whichever thread asks; what the function raised is raised at each ask.
    ``dataclasses.replace`` computes the parts that it keeps.

    Attributes
    ----------
    index : int
        Place in its sequence.
    stamp : float
        Time, s.
    name : str
        What it is called in messages and file names.
    rig : Rig
        The cameras.
    cloud : Cloud
        N points that both cameras see, in the left camera's frame, m.
    surface : Surface
        Triangles over the points, winding kept.
    complex_ : Complex
        The simplicial complex over the same N points.
    signals : Signals
        Luminance on vertices, edges and faces.
    response : Response
        The filter's answer at each vertex.
    image : (H, W) or (H, W, 3) array or None
        The left image; None where there is none, and for one read from a file that was written without one.
    valid : (H, W) bool or None
        Pixels of the image that the cameras saw; None is all of them.
    T_world_camera : (4, 4) float64
        Pose of the left camera, m, as it was tracked: what later frames tell of it is in the trajectory alone. The
        world is the first frame's camera; identity by default.
    landmark : (N,) int64 or None
        Number of the landmark of the map that each point of the cloud is, -1 for none; numbers stay
        (`MapSnapshot`). None where that is not known.
    is_keyframe : bool
        Whether the map rests on it.
    is_lost : bool
        Whether its pose is a guess, that of a constant velocity.
    quality : StereoQuality or None
        How well the two images matched; None where it was not from images.
    tracked : Tracked or None
        What the odometry said: covariance of the pose, number of landmarks; None for a frame that was not tracked.
    seconds : dict of str to float
        Own time of each stage so far, s; varies from run to run.

    Raises
    ------
    InputError
        If the pose is no (4, 4) array of finite numbers, `landmark` no (N,) array of whole ones, or `valid` none of the
        rig's size.

    Examples
    --------
    >>> from tspslam import build_complex, sample_signals, tmahf
    >>> rig, uv = Rig(fx=9, fy=9, cx=4, cy=4, baseline=0.1, width=9, height=9), np.array([[1.0, 1], [8, 2], [3, 7]])
    >>> cloud, surface = Cloud(np.eye(3), uv, np.ones(3)), Surface(np.array([[0, 1, 2]], np.int32))
    >>> complex_ = Once(lambda: build_complex(surface.faces, 3))
    >>> signals = Once(lambda: sample_signals(np.eye(9), uv, complex_()))
    >>> response = Once(lambda: tmahf(complex_(), uv, signals()))
    >>> frame = Frame(7, 0.5, "seventh", rig, cloud, surface, complex_, signals, response)
    >>> frame
    Frame(7, 'seventh', 3 points)
    >>> len(frame.response.z), frame
    (3, Frame(7, 'seventh', 3 points, 3 edges, 1 faces))
    """

    index: int
    stamp: float
    name: str
    rig: Rig
    cloud: Part[Cloud] = Part(kind=Cloud)
    surface: Part[Surface] = Part(kind=Surface)
    complex_: Part[Complex] = Part()
    signals: Part[Signals] = Part(kind=Signals)
    response: Part[Response] = Part(kind=Response)
    image: Image | None = None
    T_world_camera: FloatArray = field(default_factory=lambda: np.eye(4))
    landmark: Part[NDArray[np.int64] | None] = Part(None)
    is_keyframe: bool = False
    is_lost: bool = False
    quality: Part[StereoQuality | None] = Part(None)
    tracked: Tracked | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    valid: BoolArray | None = None

    def __post_init__(self) -> None:
        """Check what costs no computation."""
        require(self.rig, Rig, "frame: rig")
        if not isinstance(self.name, str):
            raise InputError(f"frame: name is {told(self.name)}, expected text")
        T, landmark = self.T_world_camera, self._known("landmark")
        if not (_is_array(T, "fiu", (4, 4)) and np.isfinite(T).all()):
            raise InputError(f"frame: T_world_camera is {told(T)}, expected (4, 4) finite numbers")
        size, valid = (self.rig.height, self.rig.width), self.valid
        if valid is not None and not _is_array(valid, "b", size):
            raise InputError(f"frame: valid is {told(valid)}, expected {size} of True and False")
        if landmark is not None and not _is_array(landmark, "iu", np.shape(landmark)[:1]):
            raise InputError(f"frame: landmark is {told(landmark)}, expected (N,) whole numbers")

    def __repr__(self) -> str:
        cloud, complex_ = self._known("cloud"), self._known("complex_")
        sizes = [] if cloud is None else [f"{len(cloud)} points"]
        sizes += [] if complex_ is None else [f"{len(complex_.edges)} edges", f"{len(complex_.faces)} faces"]
        states = [word for word, holds in (("keyframe", self.is_keyframe), ("lost", self.is_lost)) if holds]
        return f"Frame({', '.join([str(self.index), repr(self.name), *sizes, *states])})"

    def _known(self, part: str) -> Any:
        """A part that is there already, or None."""
        held = vars(self)[part]
        return held.value if isinstance(held, Once) else held


def _is_array(values: Any, kinds: str, shape: tuple[int, ...]) -> bool:
    return isinstance(values, np.ndarray) and values.dtype.kind in kinds and values.shape == shape
