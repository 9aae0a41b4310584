"""What a report is made of besides the numbers of a run: states of frames, judgements, pictures to page through."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Protocol

from numpy.typing import NDArray

from .._brief import Brief
from ..types import FloatArray

State = Literal["lost", "skipped", "weak", "loop", "keyframe", "tracked"]
STATES: dict[State, str] = {
    "lost": "tracking was lost: the pose is a guess",
    "skipped": "the pair could not be used",
    "weak": "few landmarks agree with the pose",
    "loop": "a loop was closed: an old place was seen again",
    "keyframe": "the map rests on it",
    "tracked": "its pose was found",
}
"""What a frame can be, the worst first, and what that means."""
Verdict = Literal["fine", "look at it", "wrong", "not known"]


class FrameState(NamedTuple):
    """How one frame of a run went: its place in the sequence, its name, its stamp in s, its state, landmarks seen."""

    frame: int
    name: str
    stamp: float | None
    state: State
    landmarks: int | None


class Finding(NamedTuple):
    """What was looked at, how it is, and a sentence on it."""

    what: str
    verdict: Verdict
    words: str


@dataclass(frozen=True, repr=False)
class Shot(Brief):
    """A frame as the gallery shows it.

    Attributes
    ----------
    index : int
        Place in its sequence.
    name : str
        What it is called.
    stamp : float
        Time, s.
    state : str
        One of `STATES`.
    counts : tuple of pairs
        Numbers below it.
    jpeg : bytes
        The image.
    size : (2,) int
        Its width and height, px.
    uv : (n, 2) float32
        Vertices, as shares of the image's width and height.
    depth : (n,) float32
        Their depth, m; NaN where there is none.
    edges : (e, 2) int32
        The mesh over the image.
    """

    index: int
    name: str
    stamp: float
    state: State
    counts: tuple[tuple[str, Any], ...]
    jpeg: bytes
    size: tuple[int, int]
    uv: NDArray[Any]
    depth: NDArray[Any]
    edges: NDArray[Any]


class PathErrors(Protocol):
    """What the report needs of the errors of a path."""

    @property
    def ate_m(self) -> FloatArray:
        """(M,) distances of matched positions after the rigid motion, m."""

    @property
    def estimate(self) -> FloatArray:
        """(M, 3) estimated positions, laid on the true ones, m."""

    @property
    def reference(self) -> FloatArray:
        """(M, 3) true positions, m."""

    @property
    def T_reference_estimate(self) -> FloatArray:
        """(4, 4) that motion."""


@dataclass(frozen=True, repr=False)
class WholeRun(Brief):
    """What `write_report` shows of a whole run besides its numbers; each part may be left out.

    Attributes
    ----------
    states : sequence of FrameState
        How each frame went, in order.
    poses : dict of int to (4, 4) float64
        ``T_world_camera`` of the frames that have a pose, by their place in the sequence, m.
    errors : TrajectoryErrors, optional
        What `tspslam.evaluate_trajectory` gave, where the true path is known; `evaluation` of the run has the figures.
    findings : sequence of Finding
        What there is to say of the calibration.
    settings : dict of dict, optional
        Settings that are not the default: ``value``, ``default``, ``unit`` and ``meaning`` by name.
    shots : iterable of Shot
        Frames for the gallery, taken one at a time.
    stored : int
        How many frames `shots` were chosen from.
    timings : str or dict, optional
        What ``timings.json`` holds; or words on where that can be seen.
    missing : sequence of str
        What could not be read, a line each.
    """

    states: Sequence[FrameState] = ()
    poses: Mapping[int, FloatArray] = field(default_factory=dict)
    errors: PathErrors | None = None
    findings: Sequence[Finding] = ()
    settings: Mapping[str, Mapping[str, Any]] | None = None
    shots: Iterable[Shot] = ()
    stored: int = 0
    timings: str | Mapping[str, Any] | None = None
    missing: Sequence[str] = ()
