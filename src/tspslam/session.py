"""One pair after another: the place where the two wings meet."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from .errors import InputError
from .topology.complex import Complex, build_complex
from .topology.harmonic import Tmahf
from .topology.surface import DelaunaySurface
from .topology.texture import sample_signals
from .types import Cloud, FloatArray, Image, Response, Rig, Signals, StereoPair, Surface
from .vision.matching import RowMatcher
from .vision.orb import OrbDetector
from .vision.reconstruct import Detector, Matcher, StereoQuality, reconstruct_with_quality


@dataclass(frozen=True)
class Settings:
    """The stages of the main job; each can be replaced by any callable of the same shape.

    Attributes
    ----------
    detector : callable, image -> Features
        Finds keypoints.
    matcher : callable, (Features, Features, StereoPair) -> matches
        Finds them again in the right image.
    surface : callable, Cloud -> Surface
        Joins the points to triangles.
    filter : callable, (Complex, uv, Signals) -> Response
        Answers at each vertex.

    Examples
    --------
    >>> Settings(filter=Tmahf(order=2)).filter
    Tmahf(order=2, centering=None)
    """

    detector: Detector = field(default_factory=OrbDetector)
    matcher: Matcher = field(default_factory=RowMatcher)
    surface: Callable[[Cloud], Surface] = field(default_factory=DelaunaySurface)
    filter: Callable[[Complex, FloatArray, Signals], Response] = field(default_factory=Tmahf)


@dataclass(frozen=True)
class Frame:
    """All that one pair gave.

    Attributes
    ----------
    pair : StereoPair
        The images and their rig.
    cloud : Cloud
        Points that both cameras see.
    surface : Surface
        Triangles over them.
    complex_ : Complex
        The simplicial complex of these.
    signals : Signals
        Luminance on vertices, edges and faces.
    response : Response
        The filter's answer at each vertex.
    quality : StereoQuality
        How well the two images matched.
    seconds : dict
        Time that each stage took, s; varies from run to run.
    """

    pair: StereoPair
    cloud: Cloud
    surface: Surface
    complex_: Complex
    signals: Signals
    response: Response
    quality: StereoQuality
    seconds: dict[str, float]

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
    """A rig, settings, and the pairs that it processes one after another.

    Parameters
    ----------
    rig : Rig
        The cameras of all pairs.
    settings : Settings, optional
        Stages; the defaults serve.

    Examples
    --------
    >>> from tspslam import datasets
    >>> pair = datasets.motorcycle()
    >>> frame = Session(pair.rig).process(pair)
    >>> len(frame.response.z) == len(frame.cloud)
    True
    """

    def __init__(self, rig: Rig, settings: Settings | None = None) -> None:
        self.rig = rig
        self.settings = settings or Settings()

    @functools.cached_property
    def fingerprints(self) -> tuple[str, ...]:
        """Hashes of the files that stages read, such as a network's; read once."""
        return tuple(getattr(stage, "fingerprint", "") for stage in vars(self.settings).values())

    def process(self, pair: StereoPair) -> Frame:
        """From a pair of images to the harmonic response at every point.

        Parameters
        ----------
        pair : StereoPair
            Of this session's rig.

        Returns
        -------
        Frame

        Raises
        ------
        InputError
            If the pair is of another rig, or its images do not fit.
        GeometryError
            If it shows too little texture for three points.
        """
        if pair.rig != self.rig:
            raise InputError(f"{pair.name}: its rig is {pair.rig}, expected the session's {self.rig}")
        stages, watch = self.settings, _Stopwatch()
        cloud, quality = reconstruct_with_quality(pair, detector=stages.detector, matcher=stages.matcher)
        watch.lap("points")
        surface = stages.surface(cloud)
        watch.lap("surface")
        complex_ = build_complex(surface.faces, len(cloud))
        watch.lap("complex")
        signals = sample_signals(pair.left, cloud.uv, complex_)
        watch.lap("signals")
        response = stages.filter(complex_, cloud.uv, signals)
        watch.lap("response")
        return Frame(pair, cloud, surface, complex_, signals, response, quality, watch.seconds)


class _Stopwatch:
    """Seconds between laps, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name] = now - self._last
        self._last = now
