"""The one page of settings: what each stage can be, where settings start, and every value with its unit and range.

Defaults, units, ranges and sources stand in the classes of the stages, beside the code that uses them; here they meet.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from ._checks import require, require_stage
from ._settings import YAML_WORDS, describe_range, describe_type, hints_of, read_meanings, setting
from .errors import InputError
from .mapping.settings import MappingSettings
from .topology.complex import Complex
from .topology.crust import Crust
from .topology.harmonic import Tmahf
from .topology.surface import DelaunaySurface
from .types import Cloud, FloatArray, Response, Signals, Surface
from .vision.features.grid import GridDetector
from .vision.features.onnx import OnnxDetector
from .vision.features.orb import OrbDetector
from .vision.features.sift_brisk import BriskDetector, SiftDetector
from .vision.slam.odometry import Tracking
from .vision.stereo.descriptor_matcher import DescriptorMatcher
from .vision.stereo.reconstruct import PAPER_MATCHER, Detector, Matcher
from .vision.stereo.row_matcher import RowMatcher
from .vision.stereo.sgbm import SgbmMatcher

KINDS: dict[str, dict[str, type]] = {
    "detector": {
        "orb": OrbDetector,
        "sift": SiftDetector,
        "brisk": BriskDetector,
        "grid": GridDetector,
        "onnx": OnnxDetector,
    },
    "matcher": {"row": RowMatcher, "descriptors": DescriptorMatcher, "sgbm": SgbmMatcher},
    "tracking": {"stereo": Tracking},
    "surface": {"delaunay": DelaunaySurface, "crust": Crust},
    "filter": {"tmahf": Tmahf},
    "mapping": {"topological": MappingSettings},
}
"""What each stage can be, by the name that its setting ``kind`` has; the first is the default."""
_PLAIN = {"tracking": Tracking, "mapping": MappingSettings}  # stages that are values alone, not called


@dataclass(frozen=True)
class Settings:
    """The stages of the main job; each can be replaced by any callable of the same shape.

    Attributes
    ----------
    detector : callable, image -> Features
        Finds keypoints. Threads call it at the same time, ahead of need, and now and then in vain: it must give the
        same for the same image, whatever it was called with before.
    matcher : callable, (Features, Features, StereoPair) -> matches
        Finds them again in the right image.
    tracking : Tracking
        How frames are joined to a path.
    surface : callable, Cloud -> Surface
        Joins the points to triangles.
    filter : callable, (Complex, uv, Signals) -> Response
        Answers at each vertex.
    mapping : MappingSettings
        How keyframes become one map.

    Examples
    --------
    >>> Settings(filter=Tmahf(order=2)).filter
    Tmahf(order=2, centering=None)
    """

    detector: Detector = setting(
        OrbDetector(), source="the paper's Figure 4; the fastest of them: docs/cameras_and_clouds"
    )
    matcher: Matcher = setting(
        RowMatcher(), source="Motorcycle: 1304 points, 96 % right to 1 px; descriptors alone 605, 71 %"
    )
    tracking: Tracking = setting(Tracking(), source="the only one")
    surface: Callable[[Cloud], Surface] = setting(
        DelaunaySurface(), source="Crust falls to pieces on open sheets: docs/paper"
    )
    filter: Callable[[Complex, FloatArray, Signals], Response] = setting(Tmahf(), source="the paper's")
    mapping: MappingSettings = setting(MappingSettings(), source="the only one")

    def __post_init__(self) -> None:
        """Refuse the name of a stage, or its class, where an object goes that can be called."""
        for name, kinds in KINDS.items():
            if name not in _PLAIN:
                such = next(iter(kinds.values())).__name__
                require_stage(getattr(self, name), f"settings: {name}", f"{such}()")
        for name, kind in _PLAIN.items():
            if not isinstance(getattr(self, name), tuple(KINDS[name].values())):
                require(getattr(self, name), kind, f"settings: {name}")


PRESETS: dict[str, Settings] = {
    "default": Settings(),
    "paper": Settings(matcher=PAPER_MATCHER, filter=Tmahf(centering="none")),
}
"""Where settings can start. ``paper``: descriptors along rows, disparities up to 48 px, and the published sum."""


@dataclass(frozen=True)
class Setting:
    """One value that can be set.

    Attributes
    ----------
    name : str
        Dotted, as in ``--set NAME=VALUE``.
    kind : str
        Which kind of its stage has it; empty if it is the choice of the kind itself.
    default : object
        Its value where none is given.
    type : object
        Annotation of its field.
    low, high : float or None
        Smallest and largest value, both allowed.
    unit : str or None
        Empty for a plain number; None if nobody has said.
    source : str
        Where the default comes from.
    meaning : str
        What it does, in a line.
    """

    name: str
    kind: str
    default: Any
    type: Any
    low: float | None
    high: float | None
    unit: str | None
    source: str
    meaning: str

    @property
    def range(self) -> str:
        """What it may be, in a few words."""
        parts = get_args(self.type) if get_origin(self.type) in (Union, UnionType) else (self.type,)
        span = describe_range(self.low, self.high)
        said = (span if span and part in (int, float) else describe_type(part, YAML_WORDS) for part in parts)
        return " or ".join(each.removeprefix("one of ") for each in said)


def list_settings(settings: Settings | None = None) -> list[Setting]:
    """Every value that can be set.

    Parameters
    ----------
    settings : Settings, optional
        Of the kinds that its stages are; else of every kind of every stage.

    Returns
    -------
    list of Setting
        Stage after stage; each starts with the choice of its kind.

    Examples
    --------
    >>> row = next(row for row in list_settings() if row.name == "surface.min_angle")
    >>> row.default, row.range, row.unit
    (3.0, '0 to 60', 'degrees')
    """
    if settings is not None:
        require(settings, Settings, "settings")
    rows: list[Setting] = []
    for stage, kinds in KINDS.items():
        chosen = kinds if settings is None else {find_kind(settings, stage): type(getattr(settings, stage))}
        rows.append(_choice(stage, kinds))
        for name, kind in chosen.items():
            rows += _values(kind(), stage, name)
    return rows


def find_kind(settings: Settings, stage: str) -> str:
    """Which of its `KINDS` a stage is.

    Parameters
    ----------
    settings : Settings
        The stages.
    stage : str
        Which of them.

    Returns
    -------
    str

    Raises
    ------
    InputError
        If it is a function of the user's own, which has no name.
    """
    chosen = type(getattr(settings, stage))
    for name, kind in KINDS[stage].items():
        if kind is chosen:
            return name
    known = ", ".join(kind.__name__ for kind in KINDS[stage].values())
    raise InputError(f"settings: {stage} is {chosen.__name__}, expected one with settings: {known}")


def find_preset(name: str) -> Settings:
    """Settings to start from.

    Parameters
    ----------
    name : str
        One of `PRESETS`.

    Returns
    -------
    Settings

    Raises
    ------
    InputError
        If the name is unknown.
    """
    if name not in PRESETS:
        raise InputError(f"preset is {name!r}, expected one of {', '.join(PRESETS)}")
    return PRESETS[name]


def _choice(stage: str, kinds: dict[str, type]) -> Setting:
    """The setting ``stage.kind``."""
    source = next(each.metadata["source"] for each in fields(Settings) if each.name == stage)
    names: Any = tuple(kinds)
    meaning = read_meanings(Settings)[stage]
    return Setting(f"{stage}.kind", "", names[0], Literal[names], None, None, "", source, meaning)


def _values(part: Any, prefix: str, kind: str, source: str = "") -> Iterator[Setting]:
    """Settings of a stage, or of a group within one at any depth; `source` is that of the group, if it has its own."""
    owner: type = type(part)
    hints, meanings = hints_of(owner), read_meanings(owner)
    for each in fields(part):
        value, name, known = getattr(part, each.name), f"{prefix}.{each.name}", each.metadata
        said = source or known.get("source", "")
        if is_dataclass(value):
            yield from _values(value, name, kind, said)
        else:
            low, high, unit = known.get("low"), known.get("high"), known.get("unit")
            yield Setting(name, kind, value, hints[each.name], low, high, unit, said, meanings.get(each.name, ""))
